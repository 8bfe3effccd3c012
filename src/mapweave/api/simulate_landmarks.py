"""Simulated recordings of a team of robots among landmarks, as MRCLAM files."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.landmark_log import TeamRecording
from ..core.paths import path_arguments
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.directory import check_target, write_json
from ..io.mrclam import write_mrclam
from ..report.result import ResultBase, Rows
from ..sim.landmarks import TeamWorld, simulate_team

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedTeam(ResultBase, TeamRecording):
    """A simulated recording of a team among landmarks, the world and the seed it came from."""

    world: TeamWorld
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        """What stands in `simulation.json`."""
        return {"version": __version__, "seed": self.seed, "world": asdict(self.world)}

    def lines(self) -> list[str]:
        seen = sum(len(r.stamps) for r in self.robots)
        return [f"{len(self.robots)} robots, {len(self.landmarks)} landmarks, {seen} sightings, seed {self.seed}"]

    def headline(self) -> Rows:
        head = ("robot", "odometry rows", "sightings", "driven [m]")
        rows = [(r.number, len(r.odometry), len(r.stamps), _driven(r.truth[:, 1:3])) for r in self.robots]
        return head, rows

    def draw(self, target: "Target") -> None:
        """The landmarks and the true trajectories."""
        from ..report.simulation import draw_world  # noqa: PLC0415  (figures cost half a second)

        ways = {f"robot {r.number}": r.truth[:, 1:3] for r in self.robots}
        draw_world(target, "the simulated team", ways, np.array(list(self.landmarks.values())).reshape(-1, 2))

    def write_into(self, folder: Path) -> None:
        """The MRCLAM layout and `simulation.json`."""
        write_mrclam(folder, self)
        write_json(folder / "simulation.json", self.metrics)


@path_arguments
@one_blas_thread()
def simulate_landmarks(
    out: Path | str | None = None,
    *,
    robots: int = 3,
    landmarks: int = 15,
    minutes: float = 5.0,
    noise: float = 1.0,
    bias: float = 1.0,
    outliers: float = 0.01,
    misreads: float = 0.001,
    seed: int = 0,
    force: bool = False,
) -> SimulatedTeam:
    """Simulate a recording of robots with wheels and cameras among landmarks, in the layout of the MRCLAM data sets.

    Written to `out` if given; the same seed gives the same recording.

    Parameters
    ----------
    out
        The folder to write: odometry, sightings and true poses of every robot, surveyed landmarks, barcodes.
    robots
        How many robots (3).
    landmarks
        How many landmarks (15); the floor grows with them, 8 square metres each.
    minutes
        How long they drive (5).
    noise
        Random errors of odometry and camera, relative to a real team's (1).
    bias
        Systematic errors (turn and speed scale, command lag, range scale, bearing bias), relative to a real team's (1).
    outliers
        Probability that a range is wrong by about a metre (0.01).
    misreads
        Probability that a sighting carries a barcode that nobody listed (0.001).
    seed
        Of everything drawn at random (0).
    force
        Write into `out` even when something other than an earlier recording stands there (False).

    Raises
    ------
    UsageError
        For a world that cannot be, or an `out` that holds something else.
    """
    world = TeamWorld(
        robots=robots,
        landmarks=landmarks,
        minutes=minutes,
        noise=noise,
        bias=bias,
        outliers=outliers,
        misreads=misreads,
    )
    world.check()
    if out is not None:
        check_target(Path(out), force=force)
    simulated = simulate_team(world, seed)
    team = SimulatedTeam(simulated.barcodes, simulated.landmarks, simulated.robots, world, seed)
    if out is not None:
        team.write(out, force=force)
    return team


def _driven(way: np.ndarray) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum())
