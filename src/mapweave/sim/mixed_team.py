"""A team in which every robot carries something else: laser scanners, cameras for landmarks, or eyes for robots alone.

They drive in rooms in a row, among landmarks on posts. The walls between rooms stop lasers and wheels; cameras stand
higher and look over them. Robots are lower than the laser's plane.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.errors import UsageError, expect_at_most
from ..core.fixes import Fixes
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track, frozen
from ..kernels.walls.segments import cast
from .landmarks import FRAME, START, TRUTH_STEP, Drive, camera_frames, command_rows, drive_team, scattered
from .laser import (
    DriftConfig,
    LaserWorld,
    Reflectance,
    Scanner,
    WallStyle,
    WorldBuilder,
    drifted,
    measure,
    placed,
    simulated_fixes,
    stream,
)

EVERY = 0.2  # [s] from one range of a pair to its next
NOISE = 0.05  # [m] sd of a range
BIAS, BIAS_SD = (
    0.3,
    0.1,
)  # [m] by which ranges are too long: mean and sd over pairs of radios
DETOUR, LEAST_DETOUR = 0.8, 0.3  # [m] how much longer a range is that went round something: mean beyond the least
BLOCKED = 2.0  # [s] for which something is in the way, in the mean


@dataclass(frozen=True, slots=True)
class SimulatedRanges:
    """Of one pair: a, b: its radios; t: (n,) [s]; z: (n,) [m]."""

    a: str
    b: str
    t: Float[np.ndarray, " n"]
    z: Float[np.ndarray, " n"]


def simulated_ranges(
    robots: Mapping[str, Track],
    beacons: Mapping[str, tuple[float, float]],
    noise: float,
    bias: float,
    nlos: float,
    rng: np.random.Generator,
) -> tuple[SimulatedRanges, ...]:
    """What every robot ranged to every other and to every beacon; `nlos`: the share of ranges that are too long."""
    names = [*robots, *beacons]
    pairs = [(a, b) for k, a in enumerate(robots) for b in names[k + 1 :]]
    out = []
    for a, b in pairs:
        track = robots[a]
        t = np.arange(track.t[0] + rng.uniform(0.0, EVERY), track.t[-1], EVERY)
        p = se2.interpolate(t, track.t, track.pose)[:, :2]
        q = se2.interpolate(t, robots[b].t, robots[b].pose)[:, :2] if b in robots else np.array(beacons[b])
        own = bias * (BIAS + BIAS_SD * float(rng.standard_normal()))
        z = np.hypot(*(p - q).T) + own + noise * NOISE * rng.standard_normal(len(t))
        detour = LEAST_DETOUR + DETOUR * rng.exponential(size=len(t))
        out.append(SimulatedRanges(a, b, t, np.maximum(z + _blocked(len(t), nlos, rng) * detour, 0.01)))
    return tuple(out)


def _blocked(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """Whether something is in the way, (n,): for a while each time, `share` of the time in all."""
    leave = EVERY / BLOCKED
    enter = leave * share / max(1.0 - share, leave)
    drawn, now, out = rng.random(n), rng.random() < share, np.zeros(n, bool)
    for k in range(n):
        out[k] = now
        now = drawn[k] >= leave if now else drawn[k] < enter
    return out


SCAN_EVERY, WHEELS_EVERY = 1.0, 0.2  # [s]; the second is a whole part of the first
SCANNER = Scanner(beams=271, opening=np.radians(270.0), far=10.0)
WHEELS = DriftConfig(scale=0.02, end_error=None)
AREA_PER_LANDMARK, LEAST_AREA = 8.0, 40.0  # [m^2] of a room
REACH, RIM, DEPTH, THICK = 0.55, 1.3, (0.2, 0.6), 0.4  # of a room's size robots go; [m] from there to the wall; boxes
MOST_ROBOTS, MOST_LANDMARKS, MOST_MINUTES = 200, 10_000, 2_000  # of one kind, and rooms; of all robots together
WILD = 3.0  # [m] sd of a range that is wrong by metres
Sees = Literal["nothing", "bearings", "ranges"]
KINDS = ("laser", "camera", "bearing-camera", "bearings")  # and ranges, in place of all of them


@config
class MixedWorld:
    """What to simulate; noise and bias are relative to a real team's (1), outliers is a share of all sightings.

    calibration: `real` draws wheels and cameras as a real team's, `random` as a careless workshop leaves them; clock:
    [s] sd of each laser log's clock; everything: every robot carries all that any of them does, on the same
    trajectories. ranges: every robot carries wheels and a ranging radio and nothing else, and so do `beacons` that
    stand; nlos: the share of ranges that go round something. fixes: [m] noise of satellite receivers on robots whose
    log is a recording (lasers, radios), where there are such; the truth is east and north of one datum then.
    """

    lasers: int = 2
    cameras: int = 2
    bearing_cameras: int = 0
    bearings: int = 1
    rooms: int = 1
    landmarks: int = 15
    minutes: float = 5.0
    noise: float = 1.0
    bias: float = 1.0
    outliers: float = 0.0
    calibration: Literal["real", "random"] = "real"
    clock: float = 0.0
    everything: bool = False
    ranges: bool = False
    beacons: int = 0
    nlos: float = 0.0
    fixes: float | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind of robots 1, 2, .."""
        counts = (self.lasers, self.cameras, self.bearing_cameras, self.bearings)
        kinds = tuple(kind for kind, n in zip(KINDS, counts, strict=True) for _ in range(n))
        return ("ranges",) * len(kinds) if self.ranges else kinds

    def check(self) -> None:
        """Raises UsageError when no world can be made of it."""
        least = {"lasers": 0, "cameras": 0, "bearing-cameras": 0, "bearings": 0, "rooms": 1, "landmarks": 0}
        for name, low in {**least, "noise": 0.0, "bias": 0.0, "clock": 0.0}.items():
            value = getattr(self, name.replace("-", "_"))
            if not low <= value < np.inf:
                raise UsageError(f"--{name} must be {low:g} or more, found {value}")
        counts = {f"--{name}": (getattr(self, name.replace("-", "_")), MOST_ROBOTS) for name in least}
        expect_at_most({**counts, "--landmarks": (self.landmarks, MOST_LANDMARKS)})
        expect_at_most({"robots times --minutes": (len(self.kinds) * self.minutes, MOST_MINUTES)})
        if not self.kinds:
            raise UsageError("a team needs a robot: --lasers, --cameras, --bearing-cameras and --bearings are all 0")
        if not 0.0 < self.minutes < np.inf:
            raise UsageError(f"--minutes must be more than 0, found {self.minutes}")
        if not 0.0 <= self.outliers <= 1.0:
            raise UsageError(f"--outliers is a share between 0 and 1, found {self.outliers}")
        self._check_radios()
        if self.fixes is not None and not (self.ranges or self.lasers or self.everything):
            raise UsageError("--fixes: only for robots with lasers or radios, whose logs are recordings")
        if self.calibration not in {"real", "random"}:
            raise UsageError(f"--calibration: expected real or random, found {self.calibration!r}")

    def _check_radios(self) -> None:
        if (self.beacons or self.nlos) and not self.ranges:
            raise UsageError("--beacons and --nlos: only with --ranges")
        if self.ranges and self.everything:
            raise UsageError("--ranges: robots with radios carry nothing else, found --everything too")
        if self.beacons < 0:
            raise UsageError(f"--beacons must be 0 or more, found {self.beacons}")
        expect_at_most({"--beacons": (self.beacons, MOST_ROBOTS)})
        if not 0.0 <= self.nlos < 1.0:
            raise UsageError(f"--nlos is a share from 0 to less than 1, found {self.nlos}")


@dataclass(frozen=True, slots=True)
class Carries:
    """What a robot has: wheels that tell their commands, a laser, a camera for landmarks, one for other robots.

    radio: it ranges to others, and its odometry tells poses.
    """

    wheels: bool
    laser: bool
    landmarks: Sees
    robots: Sees
    radio: bool = False


CARRIES = {
    "laser": Carries(wheels=False, laser=True, landmarks="nothing", robots="nothing"),
    "camera": Carries(wheels=True, laser=False, landmarks="ranges", robots="ranges"),
    "bearing-camera": Carries(wheels=True, laser=False, landmarks="bearings", robots="bearings"),
    "bearings": Carries(wheels=False, laser=False, landmarks="nothing", robots="bearings"),
    "ranges": Carries(wheels=False, laser=False, landmarks="nothing", robots="nothing", radio=True),
}
EVERYTHING = Carries(wheels=True, laser=True, landmarks="ranges", robots="ranges")


@dataclass(frozen=True, slots=True)
class SimulatedSightings:
    """n sightings in order of time. t: (n,) [s]; range: (n,) [m], NaN where it was not told; bearing: (n,) [rad]."""

    t: Float[np.ndarray, " n"]
    ids: tuple[str, ...]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class MixedRobot:
    """One robot's rows and truth.

    commands: (n, 3) t, v, w, or None; laser: its log, by its own clock, which is `clock` [s] ahead; truth: poses in the
    frame of the world; drive: as it drove, with what nobody told the robot; odometry: of a robot with a radio; fixes:
    of a robot with a receiver, by its laser's clock.
    """

    number: int
    kind: str
    carries: Carries
    commands: Float[np.ndarray, "n 3"] | None
    seen: SimulatedSightings
    laser: LaserLog | None
    clock: float
    truth: Track
    drive: Drive
    odometry: Track | None = None
    fixes: Fixes | None = None

    @property
    def name(self) -> str:
        return f"robot{self.number}"


@dataclass(frozen=True, slots=True)
class MixedRecording:
    """landmarks: id -> (x, y) [m], of a team with radios its beacons; walls: what lasers see; ranges: pair by pair."""

    robots: tuple[MixedRobot, ...]
    landmarks: dict[str, tuple[float, float]]
    walls: LaserWorld
    ranges: tuple[SimulatedRanges, ...]


def simulate_mixed(world: MixedWorld, seed: int = 0) -> MixedRecording:
    """The recording of `world`; the same for the same seed. Landmarks are L1, L2, ..

    Each robot and sensor draws from a stream of its own: what a robot carries changes nothing for the others.
    """
    world.check()
    each = [world.landmarks // world.rooms + (k < world.landmarks % world.rooms) for k in range(world.rooms)]
    area = max(LEAST_AREA, AREA_PER_LANDMARK * max(each))
    size = np.array([np.sqrt(area * 15 / 8), np.sqrt(area * 8 / 15)])
    pitch = 2 * (REACH * size[0] + RIM) + THICK
    middle = np.array([[k * pitch, 0.0] for k in range(world.rooms)])
    posts = [scattered(n, size, stream(seed, f"posts {k}")) + middle[k] for k, n in enumerate(each)]
    points = np.concatenate(posts)
    walls = _walls(middle, size, stream(seed, "walls"))
    drives = _drives(world, middle, size, seed)
    names = tuple(f"L{i + 1}" for i in range(len(points)))
    robots = tuple(_robot(k, world, drives, points, names, walls, seed) for k in range(len(drives)))
    ranges: tuple[SimulatedRanges, ...] = ()
    if world.ranges:
        points = scattered(world.beacons, size, stream(seed, "beacons"))
        names = tuple(f"beacon{k + 1}" for k in range(len(points)))
    places = {name: (float(x), float(y)) for name, (x, y) in zip(names, points, strict=True)}
    if world.ranges:
        ways = {r.name: Track(START + r.drive.t, r.drive.pose) for r in robots}
        ranges = simulated_ranges(ways, places, world.noise, world.bias, world.nlos, stream(seed, "radios"))
    made = MixedRecording(robots, places, walls, ranges)
    return made if world.fixes is None else _on_earth(made, world.fixes, seed)


def _on_earth(made: MixedRecording, sd: float, seed: int) -> MixedRecording:
    """The recording with receivers, its truth east and north of the datum that they tell of."""
    T = placed(stream(seed, "fixes"))
    robots = []
    for robot in made.robots:
        truth = replace(robot.truth, pose=np.asarray(se2.compose(T, robot.truth.pose)))
        robots.append(replace(robot, truth=truth))
        if robot.laser is not None or robot.carries.radio:
            fixes = simulated_fixes(truth, sd, stream(seed, f"receiver {robot.number}"))
            fixes = replace(fixes, t=fixes.t + robot.clock)
            laser = None if robot.laser is None else replace(robot.laser, fixes=fixes)
            robots[-1] = replace(robots[-1], laser=laser, fixes=fixes)
    there = se2.act(T, np.array(list(made.landmarks.values())).reshape(-1, 2))
    landmarks = {name: (float(x), float(y)) for name, (x, y) in zip(made.landmarks, there, strict=True)}
    ends = np.asarray(made.walls.segments).reshape(-1, 2, 2)
    walls = replace(made.walls, segments=np.asarray(se2.act(T, ends)).reshape(-1, 4))
    return MixedRecording(tuple(robots), landmarks, walls, made.ranges)


def _drives(
    world: MixedWorld, middle: Float[np.ndarray, "r 2"], size: Float[np.ndarray, "2"], seed: int
) -> list[Drive]:
    """The robots of every kind go to one room after the other."""
    before = dict.fromkeys(world.kinds, 0)
    room = []
    for kind in world.kinds:
        room.append(before[kind] % world.rooms)
        before[kind] += 1
    out: list[Drive | None] = [None] * len(room)
    for r in range(world.rooms):
        mine = [k for k, where in enumerate(room) if where == r]
        if mine:
            rng = stream(seed, f"drive {r}")
            wide = 1.0 if world.calibration == "random" else 0.0
            drives = drive_team(len(mine), size, 60 * world.minutes, world.noise, world.bias, rng, wide)
            for k, drive in zip(mine, drives, strict=True):
                out[k] = replace(drive, pose=drive.pose + np.append(middle[r], 0.0))
    return [drive for drive in out if drive is not None]


def _walls(middle: Float[np.ndarray, "r 2"], size: Float[np.ndarray, "2"], rng: np.random.Generator) -> LaserWorld:
    """Every room with its own walls and boxes along them, clear of where robots go."""
    build = WorldBuilder("rooms", WallStyle(), rng)
    half = REACH * size + RIM
    for x, y in middle.tolist():
        corners = [(x + sx * half[0], y + sy * half[1]) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            build.plain(a, b)
        for side in (-1.0, 1.0):
            for at in np.arange(-half[0] + 0.4, half[0] - 1.6, 2.2):
                if rng.random() < 0.7:
                    wide, deep = float(rng.uniform(0.4, 1.4)), float(rng.uniform(*DEPTH))
                    edge = y + side * half[1]
                    build.box(x + float(at), min(edge, edge - side * deep), wide, deep, float(rng.uniform(0.2, 0.8)))
            for at in np.arange(-half[1] + 0.8, half[1] - 1.4, 1.8):
                if rng.random() < 0.6:
                    wide, deep = float(rng.uniform(*DEPTH)), float(rng.uniform(0.3, 1.0))
                    edge = x + side * half[0]
                    build.box(min(edge, edge - side * wide), y + float(at), wide, deep, float(rng.uniform(0.2, 0.8)))
    return build.world()


def _robot(
    k: int,
    world: MixedWorld,
    drives: list[Drive],
    points: Float[np.ndarray, "n 2"],
    names: tuple[str, ...],
    walls: LaserWorld,
    seed: int,
) -> MixedRobot:
    own, kind = drives[k], world.kinds[k]
    carries = EVERYTHING if world.everything else CARRIES[kind]
    clock = world.clock * float(stream(seed, f"clock {k}").standard_normal())
    at = np.arange(0.0, own.t[-1], TRUTH_STEP)
    return MixedRobot(
        number=k + 1,
        kind=kind,
        carries=carries,
        commands=command_rows(own, stream(seed, f"commands {k}")) if carries.wheels else None,
        seen=_sightings(k, world, carries, drives, points, names, seed),
        laser=_laser(k, own, clock, walls, seed) if carries.laser else None,
        clock=clock if carries.laser else 0.0,
        truth=Track(START + at, se2.interpolate(at, own.t, own.pose), frame="world"),
        drive=own,
        odometry=_odometry(k, own, seed) if carries.radio else None,
    )


def _odometry(k: int, own: Drive, seed: int) -> Track:
    """What the wheels of robot k add up to."""
    t = WHEELS_EVERY * np.arange(int(own.t[-1] / WHEELS_EVERY) + 1)
    poses, _ = drifted(se2.interpolate(t, own.t, own.pose), WHEELS, stream(seed, f"wheels {k}"))
    return Track(START + t, poses, frame="odom")


def _sightings(
    k: int,
    world: MixedWorld,
    carries: Carries,
    drives: list[Drive],
    points: Float[np.ndarray, "n 2"],
    names: tuple[str, ...],
    seed: int,
) -> SimulatedSightings:
    """What robot k's camera told, frame by frame, some of it mislabelled or wrong by metres."""
    rng, own = stream(seed, f"camera {k}"), drives[k]
    frames = np.arange(rng.uniform(0.5, 1.0), own.t[-1], FRAME)
    pose = se2.interpolate(frames, own.t, own.pose)
    others = [se2.interpolate(frames, d.t, d.pose)[:, :2] for d in drives]
    targets = np.concatenate([np.stack(others, 1), np.broadcast_to(points, (len(frames), *points.shape))], axis=1)
    seen, ranges, bearings = camera_frames(pose, targets, k, own, world.noise, rng)
    ids = np.array([*(f"robot{j + 1}" for j in range(len(drives))), *names])
    is_robot = np.arange(len(ids)) < len(drives)
    wrong = rng.random(seen.shape) < world.outliers
    mislabel = wrong & (rng.random(seen.shape) < 0.5)
    label = rng.integers(0, len(ids), seen.shape)
    label = np.where(label == k, (label + 1) % len(ids), label)
    ranges = np.where(wrong & ~mislabel, np.abs(ranges + WILD * rng.standard_normal(seen.shape)) + 0.1, ranges)
    turned = np.pi * rng.uniform(-1.0, 1.0, seen.shape)
    for which, sees in ((is_robot, carries.robots), (~is_robot, carries.landmarks)):
        if sees == "nothing":
            seen[:, which] = False
        if sees != "ranges":
            ranges[:, which] = np.nan
            lost = wrong & ~mislabel & which
            bearings = np.where(lost, turned, bearings)
    frame = np.nonzero(seen)[0]
    what = np.where(mislabel, label, np.arange(len(ids)))[seen]
    t = START + np.round(frames[frame], 3)
    return SimulatedSightings(t, tuple(ids[what].tolist()), ranges[seen], bearings[seen])


def _laser(k: int, own: Drive, clock: float, walls: LaserWorld, seed: int) -> LaserLog:
    each = round(SCAN_EVERY / WHEELS_EVERY)
    t = WHEELS_EVERY * np.arange(int(own.t[-1] / WHEELS_EVERY) + 1)
    true = se2.interpolate(t, own.t, own.pose)
    wheels, _ = drifted(true, WHEELS, stream(seed, f"wheels {k}"))
    at = np.arange(0, len(t), each)
    nobody = np.zeros((len(at), 0, 3))
    hit_at, what, cosine = cast(
        np.ascontiguousarray(true[at]), SCANNER.angles(), walls.segments, nobody, SCANNER.far + 0.3
    )
    surface = np.append(walls.reflectance, 0.0)
    ranges, _ = measure(hit_at, what, cosine, surface[what], SCANNER, Reflectance(), stream(seed, f"scanner {k}"))
    stamp = (np.round((START + clock + t) * 1e6).astype(np.int64) * 1000) / 1e9
    scans = tuple(
        Scan(
            frozen(ranges[i]),
            frozen(ranges[i] < SCANNER.range_max, dtype=bool),
            None,
            SCANNER.angle_min,
            SCANNER.angle_increment,
            SCANNER.range_max,
            odometry=frozen(wheels[j]),
        )
        for i, j in enumerate(at.tolist())
    )
    return LaserLog(str(k + 1), f"simulated team, seed {seed}", stamp[at], scans, Track(stamp, wheels, frame="odom"))
