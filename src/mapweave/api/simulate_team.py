"""Simulated recordings of a mixed team: laser robots, camera robots, robots with nothing but bearings to the others."""

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..core.paths import path_arguments
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.directory import check_target, write_json
from ..io.mixed_team import Row, TrueTeam, write_mixed_team, write_truth
from ..io.range_bags import write_range_bag
from ..report.result import ResultBase, Rows
from ..sim.mixed_team import MixedRecording, MixedWorld, simulate_mixed
from ..team.robot_part import PARAMETERS

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedMixedTeam(ResultBase, MixedRecording):
    """A simulated recording of a mixed team, the world and the seed it came from."""

    world: MixedWorld
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        """What stands in `simulation.json`."""
        robots = {
            str(r.number): {
                "kind": r.kind,
                **asdict(r.carries),
                "sightings": len(r.seen.t),
                "scans": 0 if r.laser is None else len(r.laser.scans),
                "clock": r.clock,
            }
            for r in self.robots
        }
        return {"version": __version__, "seed": self.seed, "world": asdict(self.world), "robots": robots}

    def lines(self) -> list[str]:
        kinds = ", ".join(f"{n} {kind}" for kind, n in Counter(r.kind for r in self.robots).items())
        seen = sum(len(r.seen.t) for r in self.robots)
        if self.world.ranges:
            n = sum(len(r.t) for r in self.ranges)
            return [f"robots: {kinds}; {len(self.landmarks)} beacons, {n} ranges, seed {self.seed}"]
        return [f"robots: {kinds}; {len(self.landmarks)} landmarks, {seen} sightings, seed {self.seed}"]

    def headline(self) -> Rows:
        rows = [
            (r.number, r.kind, len(r.seen.t), 0 if r.laser is None else len(r.laser.scans), _driven(r.truth.pose))
            for r in self.robots
        ]
        return ("robot", "kind", "sightings", "scans", "driven [m]"), rows

    def draw(self, target: "Target") -> None:
        """Walls, landmarks and the true trajectories."""
        from ..report.simulation import draw_world  # noqa: PLC0415  (figures cost half a second)

        ways = {f"robot {r.number}, {r.kind}": r.truth.pose[:, :2] for r in self.robots}
        points = np.array(list(self.landmarks.values())).reshape(-1, 2)
        draw_world(target, "the simulated team", ways, points, walls=self.walls.segments)

    @property
    def truth(self) -> TrueTeam:
        """What is true of the team."""
        hidden = {str(r.number): {p: getattr(r.drive, p) for p in PARAMETERS} for r in self.robots}
        return TrueTeam(self.landmarks, self.walls.segments, {r.name: r.truth for r in self.robots}, hidden)

    def write_into(self, folder: Path) -> None:
        """The files `map` takes, `truth/` and `simulation.json`."""
        if self.world.ranges:
            wheels = {r.name: r.odometry for r in self.robots if r.odometry is not None}
            folder.mkdir(parents=True, exist_ok=True)
            write_range_bag(folder / "ranges.mcap", wheels, [(r.a, r.b, r.t, r.z) for r in self.ranges])
            write_truth(folder / "truth", self.truth)
            write_json(folder / "simulation.json", self.metrics)
            return
        rows: list[Row] = [
            (t, str(r.number), name, z, b)
            for r in self.robots
            for t, name, z, b in zip(
                r.seen.t.tolist(), r.seen.ids, r.seen.range.tolist(), r.seen.bearing.tolist(), strict=True
            )
        ]
        write_mixed_team(
            folder,
            {str(r.number): r.commands for r in self.robots if r.commands is not None},
            rows,
            [r.laser for r in self.robots if r.laser is not None],
            self.truth,
        )
        write_json(folder / "simulation.json", self.metrics)


@path_arguments
@one_blas_thread()
def simulate_team(
    out: Path | str | None = None,
    *,
    lasers: int = 2,
    cameras: int = 2,
    bearing_cameras: int = 0,
    bearings: int = 1,
    rooms: int = 1,
    landmarks: int = 15,
    minutes: float = 5.0,
    noise: float = 1.0,
    bias: float = 1.0,
    outliers: float = 0.0,
    calibration: Literal["real", "random"] = "real",
    clock: float = 0.0,
    everything: bool = False,
    ranges: bool = False,
    beacons: int = 0,
    nlos: float = 0.0,
    seed: int = 0,
    force: bool = False,
) -> SimulatedMixedTeam:
    """Simulate a recording of a mixed team: laser robots, camera robots, robots with bearings to the others alone.

    Written to `out` if given; the same seed gives the same recording.

    Parameters
    ----------
    out
        The folder to write: robotK.mcap of every laser robot, odometry.csv and sightings.csv of the others (or
        ranges.mcap), truth/.
    lasers
        How many robots with a laser scanner and wheels, and no camera (2).
    cameras
        How many robots with wheels and a camera that measures range and bearing of landmarks and of other robots (2).
    bearing_cameras
        How many robots with wheels and a camera that measures bearings alone (0).
    bearings
        How many robots with nothing but bearings to the others (1): no wheels, no landmarks.
    rooms
        How many rooms in a row (1); the walls between them stop lasers and robots, cameras look over them.
    landmarks
        How many (15); the rooms grow with them.
    minutes
        How long they drive (5).
    noise
        Random errors of wheels and cameras, relative to a real team's (1).
    bias
        Systematic errors of a `real` calibration, relative to a real team's (1).
    outliers
        The share of sightings that are mislabelled or wrong by metres (0).
    calibration
        `real`: systematic errors as a real team's; `random`: drawn from a much wider range (real).
    clock
        Standard deviation of the laser logs' clocks [s] (0).
    everything
        Every robot carries a laser, wheels and a range camera, on the same trajectories (False).
    ranges
        Every robot carries wheels and a ranging radio and nothing else: ranges.mcap in place of the other logs (False).
    beacons
        How many radios stand somewhere (0). With `ranges`.
    nlos
        The share of ranges that go round something, for seconds at a time, and are too long by decimetres and more
        (0). With `ranges`.
    seed
        Of everything drawn at random (0).
    force
        Write into `out` even when something other than an earlier recording stands there (False).

    Raises
    ------
    UsageError
        For a world that cannot be, or an `out` that holds something else.
    """
    world = MixedWorld(
        lasers=lasers,
        cameras=cameras,
        bearing_cameras=bearing_cameras,
        bearings=bearings,
        rooms=rooms,
        landmarks=landmarks,
        minutes=minutes,
        noise=noise,
        bias=bias,
        outliers=outliers,
        calibration=calibration,
        clock=clock,
        everything=everything,
        ranges=ranges,
        beacons=beacons,
        nlos=nlos,
    )
    world.check()
    if out is not None:
        check_target(Path(out), force=force)
    simulated = simulate_mixed(world, seed)
    team = SimulatedMixedTeam(simulated.robots, simulated.landmarks, simulated.walls, simulated.ranges, world, seed)
    if out is not None:
        team.write(out, force=force)
    return team


def _driven(way: np.ndarray) -> float:
    return float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum())
