"""`mapweave explore`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def explore(
    scenario: str,
    /,
    *,
    out: Path,
    robots: int | None = None,
    runs: int = 1,
    seed: int = 0,
    planner: str | None = None,
    association: str | None = None,
    noise: str = "calibrated",
    until: str = "field",
    kill: Annotated[list[str] | None, Parameter(negative="")] = None,
    drop: float = 0.0,
    config: Path | None = None,
    jobs: int = 1,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Let a team of robots decide where to drive until it knows the whole field, and score its map.

    Parameters
    ----------
    scenario
        yuan (the paper's field), yuan-large (four times as large), office (500 m^2, lasers), office-AREA, or a TOML
        file: lower, upper, landmarks, starts, walls; or sensor = "laser" with office or walls, and starts.
    out
        The folder runs.csv, metrics.json, report.html and the first run's log are written to.
    robots
        How many robots (2, or as many as the scenario has starts).
    runs
        How many runs; run k has seed + k.
    seed
        The same seed gives the same runs.
    planner
        paper, area, coverage, loop, joint, or your own as package.module:function (paper; with lasers coverage).
    association
        Which sighting is which landmark: known, nn or jcbb (jcbb); not with lasers.
    noise
        printed, calibrated, or a factor on the printed standard deviations (calibrated is 0.05); with lasers
        calibrated or a factor on the errors of odometry (calibrated is 1).
    until
        Stop when all landmarks were seen (landmarks), when no frontier is left (field), or after so many steps.
    kill
        A robot that dies, and the step at which it does, as robot2@100.
    drop
        The share of messages between the robots that is lost.
    config
        A TOML file with weights and thresholds; options on the command line win.
    jobs
        How many runs are worked on at once; the result is the same.
    force
        Write into the folder even when something other than a result stands there.
    """
    import sys

    from ..api.explore import explore as run
    from ..api.explore_options import parse_kills
    from .terminal import progress, say

    sys.path.append(str(Path.cwd()))  # where one's own planner may stand
    with progress() as on_progress:
        result = run(
            scenario,
            out,
            robots=robots,
            runs=runs,
            seed=seed,
            planner=planner,
            association=association,
            noise=noise,
            until=until,
            kill=parse_kills(kill),
            drop=drop,
            config=config,
            jobs=jobs,
            force=force,
            on_progress=on_progress,
        )
    say(result.summary())
    say(f"report: {out / 'report.html'}")
