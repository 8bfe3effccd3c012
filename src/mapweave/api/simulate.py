"""Simulated recordings with their truth: teams among landmarks, drives with a laser scanner, swarms, mixed teams."""

from collections import Counter
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..core import se2
from ..core.attitude import TURNS
from ..core.errors import UsageError, expect_at_most
from ..core.landmark_log import TeamRecording
from ..core.paths import checked_arguments
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.directory import check_target, write_json
from ..io.mcap import write_mcap
from ..io.mixed_logs import Row, TrueTeam, write_mixed_team, write_truth
from ..io.mrclam import write_mrclam
from ..io.range_bags import write_range_bag
from ..io.sightings import write_sightings
from ..io.table import write_table
from ..io.tum import write_tum
from ..report.result import ResultBase, Rows, written
from ..report.small_pages import draw_world
from ..report.style import Target
from ..sim.landmarks import TeamWorld
from ..sim.landmarks import simulate_team as drive_team
from ..sim.laser import LaserSimulation, placed, simulated_fixes, stream
from ..sim.laser_worlds import (
    CorridorConfig,
    OfficeConfig,
    TunnelConfig,
    simulate_corridor,
    simulate_office,
    simulate_tunnel,
)
from ..sim.mixed_team import MixedRecording, MixedWorld, simulate_mixed
from ..sim.swarm import Swarm, SwarmScene
from ..sim.swarm import simulate_swarm as simulate
from ..team.robot_part import PARAMETERS


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

    def draw(self, target: Target) -> None:
        """The landmarks and the true trajectories."""
        ways = {f"robot {r.number}": r.truth[:, 1:3] for r in self.robots}
        draw_world(target, "the simulated team", ways, np.array(list(self.landmarks.values())).reshape(-1, 2))

    def write_into(self, folder: Path) -> None:
        """The MRCLAM layout and `simulation.json`."""
        write_mrclam(folder, self)
        write_json(folder / "simulation.json", self.metrics)


@checked_arguments
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
    check_target(out, force=force)
    simulated = drive_team(world, seed)
    team = SimulatedTeam(simulated.barcodes, simulated.landmarks, simulated.robots, world, seed)
    return written(team, out, force=force)


MOST_BEAMS, MOST_PEOPLE, MOST_ROOMS, MOST_SCANS = 20_000, 1000, 500, 200_000  # a log of gigabytes
FARTHEST = 100_000.0  # [m]

World = CorridorConfig | OfficeConfig | TunnelConfig


@dataclass(frozen=True, slots=True, repr=False)
class SimulatedDrive(ResultBase, LaserSimulation):
    """A simulated drive with a laser scanner, its world and seed. It is written to a file, not to a folder."""

    config: World
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        way = (len(self.log.scans) - 1) * self.config.drive.scan_every
        return {
            "version": __version__,
            "seed": self.seed,
            "kind": type(self.config).__name__.removesuffix("Config").lower(),
            "scans": len(self.log.scans),
            "stamps": len(self.log.stamps()),
            "driven_m": way,
            "world": asdict(self.config),
        }

    def lines(self) -> list[str]:
        m = self.metrics
        return [f"{m['scans']} scans over {m['driven_m']:.0f} m, {m['stamps']} stamps, seed {self.seed}"]

    def draw(self, target: Target) -> None:
        """The walls and the true trajectory."""
        walls = self.world.segments.reshape(-1, 4)
        draw_world(target, "the simulated drive", {"true way": self.truth.pose[:, :2]}, walls=walls)

    @checked_arguments
    def write(self, folder: Path | str, *, force: bool = False) -> None:
        """The MCAP file `folder`, and the true poses in FILE.truth.tum beside it; files there are replaced."""
        del force
        path = _mcap(folder)
        write_mcap(path, self.log, self.truth, range_min=self.config.drive.scanner.near)
        write_tum(path.with_suffix(".truth.tum"), self.truth)

    def write_into(self, folder: Path) -> None:
        self.write(folder / "drive.mcap")


@checked_arguments
@one_blas_thread()
def simulate_laser(
    out: Path | str | None = None, world: World | None = None, *, fixes: float | None = None, seed: int = 0
) -> SimulatedDrive:
    """Simulate a drive with a laser scanner that measures received light intensity.

    Written to `out` if given; the same seed gives the same drive.

    Parameters
    ----------
    out
        The MCAP file to write; the true poses stand beside it in FILE.truth.tum.
    world
        A `CorridorConfig` (a ring of corridor), an `OfficeConfig` or a `TunnelConfig` (the ring).
    fixes
        Also carry a satellite receiver with so much noise [m] on either axis; drives of other seeds lie elsewhere, and
        the truth is east and north of one datum (no receiver).

    Raises
    ------
    UsageError
        For an `out` that is no `.mcap` file, or a world that cannot be.
    """
    world = world or CorridorConfig()
    _check(world)
    _check_receivers(fixes)
    if out is not None:
        _mcap(out)
    if isinstance(world, CorridorConfig):
        simulated = simulate_corridor(world, seed)
    elif isinstance(world, OfficeConfig):
        simulated = simulate_office(world, seed)
    else:
        simulated = simulate_tunnel(world, seed)
    if fixes is not None:
        simulated = _with_fixes(simulated, fixes, seed)
    result = SimulatedDrive(
        simulated.log, simulated.truth, simulated.reflectance, simulated.world, simulated.heading_bias, world, seed
    )
    if out is not None:
        result.write(out)
    return result


def _check_receivers(sd: float | None) -> None:
    if sd is not None and not 0 < sd <= FARTHEST:
        raise UsageError(f"--fixes: expected a noise of more than 0 m, found {sd:g}")


def _with_fixes(drive: LaserSimulation, sd: float, seed: int) -> LaserSimulation:
    """The drive with a receiver's fixes, its truth in the world they are told in."""
    rng = stream(seed, "fixes")
    truth = replace(drive.truth, pose=np.asarray(se2.compose(placed(rng), drive.truth.pose)))
    return replace(drive, log=replace(drive.log, fixes=simulated_fixes(truth, sd, rng)), truth=truth)


def _mcap(out: Path | str) -> Path:
    path = Path(out)
    if path.suffix != ".mcap" or path.is_dir():
        raise UsageError(f"--out {path}: expected a file name such as corridor.mcap")
    return path


def _check_share(option: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise UsageError(f"{option}: expected a share from 0 to 1, found {value:g}")


def _check(world: World) -> None:
    drive = world.drive
    positive: dict[str, float] = {
        "--scan-every": drive.scan_every,
        "--speed": drive.speed,
        "--range": drive.scanner.far,
        "--falloff": drive.law.falloff,
        "--beams": drive.scanner.beams - 1,
    }
    if isinstance(world, CorridorConfig):
        room = 0.5 * min(world.long_leg, world.short_leg) - world.corner
        positive |= {"--distance": world.distance, "--width": world.width, "--corner": world.corner, "--long-leg": room}
        straight = (world.corner, world.long_leg - world.corner)
        if room > 0 and not straight[0] < world.start < straight[1]:
            between = f"between {straight[0]:g} and {straight[1]:g} m along a leg of {world.long_leg:g} m"
            raise UsageError(f"--start: expected {between}, found {world.start:g}")
    elif isinstance(world, OfficeConfig):
        positive |= {"--rooms": world.rooms, "--visited": world.visited}
        _check_share("--glazed", world.glazed)
    else:
        positive |= {"--length": world.length - 10, "--width": world.width}
    for option, value in positive.items():
        if not value > 0:
            raise UsageError(f"{option}: too small for this world")
    _check_share("--specular", drive.law.specular)
    expect_at_most({"--beams": (drive.scanner.beams, MOST_BEAMS), "--people": (drive.people, MOST_PEOPLE)})
    if isinstance(world, OfficeConfig):
        expect_at_most({"--rooms": (world.rooms, MOST_ROOMS)})
        way = 2 * world.rooms * world.room_width + 4 * world.visited * (world.room_width + world.room_depth)
    elif isinstance(world, CorridorConfig):
        expect_at_most({"--long-leg": (world.long_leg, FARTHEST), "--short-leg": (world.short_leg, FARTHEST)})
        way = world.distance
    else:
        way = 2 * world.length
    expect_at_most({"metres driven": (way, FARTHEST), "scans": (way / drive.scan_every, MOST_SCANS)})
    period = drive.scan_every / drive.speed
    if not 0.0 <= drive.sweep <= period:
        raise UsageError(f"--sweep: expected 0 to the {period:g} s from scan to scan, found {drive.sweep:g}")
    if drive.people < 0:
        raise UsageError(f"--people must be 0 or more, found {drive.people}")


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class SimulatedSwarm(ResultBase, Swarm):
    """A simulated swarm that sees itself, its scene and seed. It is written to files, not to a folder."""

    scene: SwarmScene
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        sightings = len(self.table.observer)
        return {"version": __version__, "seed": self.seed, "sightings": sightings, **asdict(self.scene)}

    def lines(self) -> list[str]:
        s = self.scene
        sigma = f"{np.degrees(s.sigma):.4g} deg"
        return [f"{s.robots} robots in {s.dim}D, {len(self.table.observer)} sightings, sigma {sigma}, seed {self.seed}"]

    def draw(self, target: Target) -> None:
        """Where the robots are at first, and who sees whom."""
        pairs = zip(self.table.observer.tolist(), self.table.target.tolist(), strict=True)
        draw_world(target, "the simulated swarm", {}, self.position[0, :, :2], pairs=list(pairs))

    @checked_arguments
    def write(self, folder: Path | str, *, force: bool = False) -> None:
        """The table `folder`, .csv or .parquet, and beside it the truth and the odometry; files there are replaced."""
        del force
        path = _table(folder)
        write_sightings(path, self.table)
        _write_truth(path.with_suffix(".truth.csv"), self)
        if self.odometry is not None:
            _write_odometry(path.with_suffix(".odometry.csv"), self)

    def write_into(self, folder: Path) -> None:
        self.write(folder / "swarm.csv")


@checked_arguments
@one_blas_thread()
def simulate_swarm(out: Path | str | None = None, scene: SwarmScene | None = None, *, seed: int = 0) -> SimulatedSwarm:
    """Simulate a swarm of camera robots that measure bearings to each other.

    Written to `out` if given; the same seed gives the same swarm.

    Parameters
    ----------
    out
        The table to write, .csv or .parquet. Beside FILE.csv stand FILE.truth.csv (`id,x,y[,z]`, and `t`, `heading`
        or in space `rx,ry,rz` where they mean something) and, when the robots drive, FILE.odometry.csv (`t,robot,v,w`).
    scene
        How many robots, how far they see, how they move, and the noise (`SwarmScene()`).

    Raises
    ------
    UsageError
        For a scene that cannot be, or an `out` that is no such file.
    """
    if out is not None:
        _table(out)
    scene = scene or SwarmScene()
    simulated = simulate(scene, np.random.default_rng(seed))
    result = SimulatedSwarm(**{f.name: getattr(simulated, f.name) for f in fields(simulated)}, scene=scene, seed=seed)
    if out is not None:
        result.write(out)
    return result


def _table(out: Path | str) -> Path:
    path = Path(out)
    if path.is_dir() or path.suffix.lower() not in {".csv", ".parquet", ".pq"}:
        raise UsageError(f"--out {path}: expected a file name such as swarm.csv or swarm.parquet")
    return path


def _write_truth(path: Path, swarm: Swarm) -> None:
    moving = swarm.table.t is not None
    turned = not swarm.table.axis or swarm.odometry is not None
    head = ["id", "x", "y", "z"][: 1 + swarm.table.dim] + ["t"] * moving + list(TURNS[swarm.table.dim]) * turned
    rows = []
    for k, t in enumerate(swarm.t.tolist()):
        places, headings = swarm.position[k].tolist(), swarm.heading[k].reshape(len(swarm.heading[k]), -1).tolist()
        rows += [
            (name, *place, *([t] if moving else []), *(heading if turned else []))
            for name, place, heading in zip(swarm.table.ids, places, headings, strict=True)
        ]
    write_table(path, head, rows)


def _write_odometry(path: Path, swarm: Swarm) -> None:
    assert swarm.odometry is not None  # noqa: S101
    still = set(swarm.corners)
    rows = [
        (t, name, *swarm.odometry[k, i].tolist())
        for k, t in enumerate(swarm.t.tolist())
        for i, name in enumerate(swarm.table.ids)
        if i not in still
    ]
    write_table(path, ["t", "robot", "v", "w"], rows)


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

    def draw(self, target: Target) -> None:
        """Walls, landmarks and the true trajectories."""
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
            told = {r.name: r.fixes for r in self.robots if r.fixes is not None}
            write_range_bag(folder / "ranges.mcap", wheels, [(r.a, r.b, r.t, r.z) for r in self.ranges], told)
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


@checked_arguments
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
    fixes: float | None = None,
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
    fixes
        Robots with a laser or a radio also carry a satellite receiver with so much noise [m] on either axis; teams of
        other seeds lie elsewhere, and the truth is east and north of one datum (no receiver).
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
        fixes=fixes,
    )
    world.check()
    _check_receivers(fixes)
    check_target(out, force=force)
    simulated = simulate_mixed(world, seed)
    team = SimulatedMixedTeam(simulated.robots, simulated.landmarks, simulated.walls, simulated.ranges, world, seed)
    return written(team, out, force=force)


def _driven(way: np.ndarray) -> float:
    return float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum())
