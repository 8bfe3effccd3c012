"""Every measured table of the documentation: its name, its page, the command that measures it.

A table stands on its page between `<!-- NAME: begin -->` and `<!-- NAME: end -->`. To register one, put the marks on
the page and add a line here.
"""

from dataclasses import dataclass

PYTHON = "python"  # stands for the interpreter that runs this; {page}, {out} for the page and an empty folder
FUSION, SWARM = "docs/methods/relative-fusion.md", "docs/methods/bearing-swarm.md"
LASER, EXPLORE = "docs/methods/intensity-laser.md", "docs/methods/active-exploration.md"
CHECKED_ELSEWHERE = {"walks"}  # marks of what is no measurement


@dataclass(frozen=True, slots=True)
class Table:
    """One table. page: "" of one whose numbers stand in sentences alone. written: how the command gives it.

    stdout: as the Markdown table that it prints; page: into the page itself, between the marks; a file's name, which
    ends in `.md`: as that file in {out}.
    """

    name: str
    page: str
    command: tuple[str, ...]
    written: str = "stdout"

    @property
    def told(self) -> str:
        """The command as a reader would type it."""
        shown = {"{page}": self.page, "{out}": "DIR"}
        return " ".join(shown.get(word, word) for word in self.command)


def bench(script: str, *words: str) -> tuple[str, ...]:
    return (PYTHON, f"benchmarks/{script}.py", *words)


def reproduce(paper: str) -> tuple[str, ...]:
    return ("mapweave", "reproduce", paper, "--out", "{out}")


def paper(name: str, page: str, shown: tuple[str, ...], said: tuple[str, ...]) -> tuple[Table, ...]:
    """The tables of a paper: `shown` on its page, `said` in sentences alone, and the closing one."""
    return (
        *(Table(f"{name} {file}", page, reproduce(name), f"tables/{file}.md") for file in shown),
        *(Table(f"{name} {file}", "", reproduce(name), f"tables/{file}.md") for file in said),
        Table(f"{name} claims", page, reproduce(name), "claims.md"),
    )


TABLES = (
    Table("team smoothing", "docs/landmark-mapping.md", bench("team_smoothing", "--page", "{page}"), "page"),
    Table("without wheels", "docs/landmark-mapping.md", bench("team_smoothing", "--no-odometry"), "stdout"),
    Table("beside gtsam", "docs/landmark-mapping.md", bench("beside_gtsam"), "stdout"),
    Table("mutants", "docs/contributing.md", bench("mutants", "--quick", "--n", "6", "--seed", "23", "--page"), "page"),
    Table("changes", "docs/laser-teams.md", bench("changes"), "stdout"),
    Table("scanners that turn", "docs/laser.md", bench("sweep"), "stdout"),
    Table("glass", "docs/laser.md", bench("glass"), "stdout"),
    Table("narrow views", "docs/laser.md", bench("narrow"), "stdout"),
    Table("doctor trials", "docs/doctor.md", bench("doctor"), "stdout"),
    Table(
        "merge trials",
        "docs/laser-teams.md",
        bench("merge_trials", "--trials", "200", "--seed", "20000", "--pictures", "--page", "{page}"),
        "page",
    ),
    Table(
        "merge trust",
        "docs/laser-teams.md",
        bench("merge_trust", "--trials", "200", "--seed", "800000", "--page", "{page}"),
        "page",
    ),
    Table("live", "docs/live.md", bench("live", "--out", "docs/images"), "stdout"),
    Table("live explore", "docs/live.md", bench("live_explore"), "stdout"),
    Table("live ties", "docs/live.md", bench("live_passes", "--table", "--seconds", "60"), "stdout"),
    Table("live growth", "docs/live.md", bench("live_passes", "--growth", "10:10,50:10,200:6,1000:6"), "stdout"),
    Table("live harm", "docs/live.md", bench("live_harm", "--kills", "50,8", "--still", "30,10"), "stdout"),
    Table("live scanners", "docs/live.md", bench("live_passes", "--scanners"), "stdout"),
    Table("live laps", "docs/live.md", bench("live_laps"), "stdout"),
    Table(
        "two in one office",
        "",
        bench("laser_consistency", "--worlds", "pairs", "--runs", "10", "--seed", "300"),
        "stdout",
    ),
    Table("logs of all kinds", "docs/laser.md", bench("places"), "stdout"),
    Table("carried robots", "docs/laser.md", bench("carried"), "stdout"),
    Table("changed logs", "docs/laser.md", bench("laser_variants"), "stdout"),
    Table("wheels and mounting", "docs/laser.md", bench("laser_calibration"), "stdout"),
    Table("pose graphs", "docs/laser.md", bench("solve"), "stdout"),
    Table("ranges", "docs/methods/ranging.md", bench("ranges"), "stdout"),
    Table("fixes", "docs/methods/fixes.md", bench("fixes"), "stdout"),
    Table("fixes of teams", "docs/methods/fixes.md", bench("fixes", "--teams"), "stdout"),
    Table("sensors", "docs/sensors.md", bench("sensors"), "stdout"),
    Table("fixes of radios", "docs/methods/fixes.md", bench("fixes", "--radios"), "stdout"),
    Table("starts searched", "docs/laser.md", bench("localize_trust"), "stdout"),
    Table(
        "wrong sightings",
        "docs/methods/team-smoothing.md",
        bench("mixed_teams", "--robots", "2", "--seeds", "10", "--first", "200"),
        "stdout",
    ),
    Table(
        "mixed teams",
        "docs/methods/team-smoothing.md",
        bench("mixed_teams", "--mixed", "--seeds", "3", "--first", "300"),
        "stdout",
    ),
    Table("growth of a team", "docs/methods/team-smoothing.md", bench("team_growth"), "stdout"),
    Table("swarm of 1,000", "docs/locate.md", bench("swarm_tables", "accuracy"), "stdout"),
    Table("swarm of 10,000", "docs/locate.md", bench("swarm_tables", "cost"), "stdout"),
    Table("angulation", "docs/locate.md", bench("swarm_real", "--table", "angulation"), "stdout"),
    Table("angulation readings", "", bench("swarm_real", "--table", "readings"), "stdout"),
    Table("bearings of set 6", "", bench("swarm_real", "--table", "drive"), "stdout"),
    Table("joining", "docs/methods/joining.md", bench("real_sets", "--table", "whole"), "stdout"),
    Table("unequal maps", "docs/methods/joining.md", bench("real_sets", "--table", "unequal"), "stdout"),
    Table("without names", "docs/methods/joining.md", bench("real_sets", "--table", "names"), "stdout"),
    Table("identities", "docs/methods/joining.md", bench("identities", "--seed", "500"), "stdout"),
    Table("renaming", "docs/methods/joining.md", bench("renaming", "--seed", "500"), "stdout"),
    Table("fusing at once", "docs/methods/joining.md", bench("fusion", "--robots", "50"), "stdout"),
    Table("kojima asserted", FUSION, bench("asserted"), "stdout"),
    *paper("kojima", FUSION, ("table2", "unequal", "identities"), ("trace", "honesty", "settling")),
    Table("belief propagation", SWARM, bench("swarm_tables", "messages"), "stdout"),
    Table("swarm grid", SWARM, bench("swarm_tables", "grid"), "stdout"),
    Table("swarm attitudes", SWARM, bench("swarm_tables", "attitudes", "--draws", "12"), "stdout"),
    Table("swarm trust", SWARM, bench("swarm_trust", "--draws", "6"), "stdout"),
    Table("swarm trust anew", "", bench("swarm_trust", "--draws", "6", "--seed", "2000"), "stdout"),
    Table("wrong bearings", SWARM, bench("swarm_outliers"), "stdout"),
    *paper("hamatani", SWARM, ("drift", "beyond"), ()),
    Table("clouds", "docs/laser.md", bench("recordings", "clouds"), "stdout"),
    Table("imu", "docs/laser.md", bench("recordings", "imu"), "stdout"),
    Table("tags", "docs/landmark-mapping.md", bench("recordings", "tags"), "stdout"),
    Table("intel relations", LASER, bench("laser_real"), "stdout"),
    Table("light on real logs", LASER, bench("light_real"), "stdout"),
    Table("light of real scanners", LASER, bench("light_laws"), "stdout"),
    Table("simulated light of real scanners", LASER, bench("light_simulated"), "stdout"),
    Table("512 particles", LASER, bench("laser_filter"), "stdout"),
    Table("laps of a hall", LASER, bench("laser_laps"), "stdout"),
    Table("kept of a lap", LASER, bench("laser_laps", "--laps", "40", "--kept"), "stdout"),
    Table("simulated ring", LASER, bench("corridor"), "stdout"),
    *paper("hara", LASER, (), ("methods", "gate", "starts", "bounds", "alpha", "walls")),
    Table("harder missions", EXPLORE, bench("exploration_laser", "--hard"), "stdout"),
    Table("unknown starts", EXPLORE, bench("exploration_laser", "--unknown-starts"), "stdout"),
    Table("wheels", "", bench("wheels"), "stdout"),
    Table("laser exploration", EXPLORE, bench("exploration_laser", "--tables", "{out}"), "exploration.md"),
    Table("laser missions", EXPLORE, bench("exploration_laser", "--tables", "{out}"), "missions.md"),
    Table("laser ring", EXPLORE, bench("exploration_ring"), "stdout"),
    Table("yuan other seeds", EXPLORE, bench("exploration_seeds"), "stdout"),
    *paper(
        "yuan", EXPLORE, ("table1", "turning", "area", "seen", "unseen", "goals", "stability", "changes"), ("ablation",)
    ),
    Table("among walls", EXPLORE, bench("exploration", "--table", "walls"), "stdout"),
    Table("unknown starts among landmarks", EXPLORE, bench("exploration", "--table", "starts"), "stdout"),
    Table("radio among landmarks", EXPLORE, bench("exploration", "--table", "radio"), "stdout"),
    Table("kidnapped among landmarks", EXPLORE, bench("exploration", "--table", "kidnapped"), "stdout"),
    Table("submaps", EXPLORE, bench("exploration", "--table", "submaps"), "stdout"),
    Table("planning alone", EXPLORE, bench("exploration_planning"), "stdout"),
)
