"""A team of robots with cameras among landmarks: commands that lag and turn too little, ranges that are scaled and
wrong for seconds on end, sightings of each other, misread barcodes. What real logs do, from one seed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.config import config
from ..core.errors import DataError, UsageError, expect_at_most
from ..core.landmark_log import RobotRecording, TeamRecording
from ..core.records import freeze
from ..core.walls import Walls

COMMAND_STEP = 0.02  # [s] between command rows
DECIDE_EVERY = 10  # rows between new commands
TOP_SPEED, TOP_TURN = 0.14, 0.5  # [m/s], [rad/s]
SLIP_V, SLIP_W = 0.05, 0.05  # of the velocity, one sigma
CREEP_V, CREEP_W = 0.002, 0.008  # [m/s], [rad/s], one sigma
SLIP_MEMORY = 1.0  # [s]


@dataclass(frozen=True, slots=True)
class Drive:
    """t: (n,) [s] from 0; command: (n, 2) v, w as logged; pose: (n, 3) as driven; then what nobody told the robot."""

    t: Float[np.ndarray, " n"]
    command: Float[np.ndarray, "n 2"]
    pose: Float[np.ndarray, "n 3"]
    speed_scale: float
    turn_scale: float
    lag: float
    bearing_bias: float
    range_scale: float


def scattered(count: int, size: Float[np.ndarray, "2"], rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """`count` points in a rectangle of `size` [m] round the origin, none very near another (best of ten draws)."""
    points = np.zeros((count, 2))
    for i in range(count):
        draws = rng.uniform(-0.5, 0.5, (10, 2)) * size
        if i:
            away = np.linalg.norm(draws[:, None] - points[None, :i], axis=2).min(1)
            points[i] = draws[np.argmax(away)]
        else:
            points[i] = draws[0]
    return points


def drive_team(
    robots: int,
    size: Float[np.ndarray, "2"],
    seconds: float,
    noise: float,
    bias: float,
    rng: np.random.Generator,
    wide: float = 0.0,
) -> list[Drive]:
    """Each robot roams round a home of its own; neighbouring homes overlap.

    wide: times what a careless workshop leaves of wheels and cameras, instead of `bias` times a real team's errors.
    """
    n = max(2, round(seconds / COMMAND_STEP))
    homes = scattered(robots, 0.7 * size, rng)
    roam = max(4.0, 1.2 * np.sqrt(size[0] * size[1] / robots))
    v_scale = 1 + bias * rng.normal(-0.02, 0.02, robots)
    w_scale = 1 + bias * rng.normal(-0.07, 0.02, robots)
    lag = np.round(bias * rng.uniform(0.12, 0.20, robots) / COMMAND_STEP).astype(np.intp)
    range_scale = 1 + bias * rng.normal(0.0, 0.01, robots)
    bearing_bias = bias * rng.normal(0.0, 0.006, robots)
    if wide > 0:
        v_scale = 1 + wide * rng.uniform(-0.1, 0.1, robots)
        w_scale = 1 + wide * rng.uniform(-0.3, 0.1, robots)
        lag = np.round(wide * rng.uniform(0.0, 0.3, robots) / COMMAND_STEP).astype(np.intp)
        range_scale = 1 + wide * rng.normal(0.0, 0.02, robots)
        bearing_bias = wide * rng.normal(0.0, 0.02, robots)

    pose = np.zeros((n, robots, 3))
    command = np.zeros((n, robots, 2))
    pose[0, :, :2], pose[0, :, 2] = homes, rng.uniform(-np.pi, np.pi, robots)
    goal = _waypoints(homes, roam, size, rng)
    fade = np.exp(-COMMAND_STEP / SLIP_MEMORY)
    slip = rng.normal(size=(robots, 2))
    slips = np.sqrt(1 - fade * fade) * rng.normal(size=(n, robots, 2))
    for k in range(n):
        slips[k] += fade * (slips[k - 1] if k else slip)
    everyone = np.arange(robots)
    for start in range(0, n - 1, DECIDE_EVERY):
        rows = slice(start, min(start + DECIDE_EVERY, n - 1))
        reached = np.linalg.norm(goal - pose[start, :, :2], axis=1) < 0.4
        if reached.any():
            goal[reached] = _waypoints(homes[reached], roam, size, rng)
        command[rows] = _towards(pose[start], goal)
        heard = np.arange(rows.start, rows.stop)[:, None] - lag
        v, w = np.moveaxis(command[np.maximum(heard, 0), everyone] * (heard >= 0)[..., None], -1, 0)
        slip_v, slip_w = np.moveaxis(noise * slips[rows], -1, 0)
        driven_v = v_scale * v + slip_v * (SLIP_V * np.abs(v) + CREEP_V * (v > 0))
        driven_w = w_scale * w + slip_w * (SLIP_W * np.abs(w) + CREEP_W * (v > 0))
        steps = se2.exp(np.stack([driven_v, np.zeros_like(v), driven_w], axis=-1) * COMMAND_STEP)
        for k, step in enumerate(steps, rows.start):
            pose[k + 1] = se2.compose(pose[k], step)
    command[-1] = command[-2]
    t = COMMAND_STEP * np.arange(n)
    hidden = np.column_stack([v_scale, w_scale, lag * COMMAND_STEP, bearing_bias, range_scale])
    return [Drive(t, command[:, k], pose[:, k], *hidden[k].tolist()) for k in range(robots)]


def _waypoints(
    homes: Float[np.ndarray, "k 2"], roam: float, size: Float[np.ndarray, "2"], rng: np.random.Generator
) -> Float[np.ndarray, "k 2"]:
    turn = rng.uniform(-np.pi, np.pi, len(homes))
    away = roam * np.sqrt(rng.uniform(0.05, 1.0, len(homes)))
    points = homes + away[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(np.clip(points, -0.55 * size, 0.55 * size))


def _towards(pose: Float[np.ndarray, "k 3"], goal: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    """Turn to the goal, drive as far as the robot already looks there; in thousandths, as a log would keep it."""
    d = goal - pose[:, :2]
    off = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - pose[:, 2])
    w = np.clip(0.8 * off, -TOP_TURN, TOP_TURN)
    v = TOP_SPEED * np.clip(np.cos(off), 0.0, 1.0)
    return np.round(np.column_stack([v, w]), 3)


START = 1.7e9  # Unix seconds of the first row
FRAME = 0.236  # [s] between camera frames
FIELD_OF_VIEW = 0.55  # [rad] to either side
NEAREST, FARTHEST = 0.7, 7.5  # [m]
SEEN = 0.65  # of the frames that could show a target do
RANGE_FLOOR, RANGE_SLOPE, BEARING_SIGMA = 0.05, 0.045, 0.014  # [m], [1], [rad]
RANGE_MEMORY, BEARING_MEMORY = 6.0, 2.0  # [s] over which errors to one target fade
RANGE_WHITE, BEARING_WHITE = 0.05, 0.5  # share of the variance that is new in every frame
TRUTH_STEP = 0.06  # [s]
AREA_PER_LANDMARK = 8.0  # [m^2]
MOST_ROBOTS, MOST_LANDMARKS, MOST_MINUTES = 1000, 10_000, 10_000  # the last of all robots together: 1 GB


@config
class TeamWorld:
    """What to simulate. noise and bias are relative to a real team's (1); outliers and misreads are probabilities."""

    robots: int = 3
    landmarks: int = 15
    minutes: float = 5.0
    noise: float = 1.0
    bias: float = 1.0
    outliers: float = 0.01
    misreads: float = 0.001

    def check(self) -> None:
        """Raises UsageError when no world can be made of it."""
        for name, least in (("robots", 1), ("landmarks", 0), ("noise", 0.0), ("bias", 0.0)):
            if not least <= getattr(self, name) < np.inf:
                raise UsageError(f"--{name} must be {least} or more, found {getattr(self, name)}")
        if not 0.0 < self.minutes < np.inf:
            raise UsageError(f"--minutes must be more than 0, found {self.minutes}")
        for name in ("outliers", "misreads"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise UsageError(f"--{name} is a probability between 0 and 1, found {getattr(self, name)}")
        expect_at_most({"--robots": (self.robots, MOST_ROBOTS), "--landmarks": (self.landmarks, MOST_LANDMARKS)})
        expect_at_most({"--robots times --minutes": (self.robots * self.minutes, MOST_MINUTES)})


def simulate_team(world: TeamWorld, seed: int = 0) -> TeamRecording:
    """The recording of `world`; the same for the same seed. Subjects: robots 1 .. R, then landmarks."""
    world.check()
    rng = np.random.default_rng([seed, 20120])
    area = max(40.0, AREA_PER_LANDMARK * world.landmarks)
    size = np.array([np.sqrt(area * 15 / 8), np.sqrt(area * 8 / 15)])
    landmarks = scattered(world.landmarks, size, rng)
    drives = drive_team(world.robots, size, 60 * world.minutes, world.noise, world.bias, rng)

    count = world.robots + world.landmarks
    codes = rng.permutation(np.arange(5, max(100, 5 + 2 * count)))
    barcodes = {subject + 1: int(codes[subject]) for subject in range(count)}
    unlisted = codes[count:]
    robots = tuple(
        _record(k, drives, landmarks, np.array([barcodes[s + 1] for s in range(count)]), unlisted, world, rng)
        for k in range(world.robots)
    )
    places = {world.robots + 1 + i: (float(x), float(y)) for i, (x, y) in enumerate(landmarks)}
    return TeamRecording(barcodes, places, robots)


def _record(
    k: int,
    drives: list[Drive],
    landmarks: Float[np.ndarray, "n 2"],
    codes: np.ndarray,
    unlisted: np.ndarray,
    world: TeamWorld,
    rng: np.random.Generator,
) -> RobotRecording:
    own = drives[k]
    frames = np.arange(rng.uniform(0.5, 1.0), own.t[-1], FRAME)
    pose = se2.interpolate(frames, own.t, own.pose)
    others = [se2.interpolate(frames, d.t, d.pose)[:, :2] for d in drives]
    targets = np.concatenate([np.stack(others, 1), np.broadcast_to(landmarks, (len(frames), *landmarks.shape))], axis=1)
    seen, ranges, bearings = camera_frames(pose, targets, k, own, world.noise, rng)
    frame, target = np.nonzero(seen)
    r, b = ranges[seen], bearings[seen]
    wild = rng.random(len(r)) < world.outliers * np.minimum((r / 3.5) ** 2, 3.0)
    r = np.where(wild, np.abs(r + rng.normal(0.0, 1.0, len(r))) + 0.1, r)
    code = np.where(rng.random(len(r)) < world.misreads, rng.choice(unlisted, len(r)), codes[target])
    truth_at = np.arange(0.0, own.t[-1], TRUTH_STEP)
    truth = np.column_stack([START + truth_at, se2.interpolate(truth_at, own.t, own.pose)])
    return RobotRecording(
        number=k + 1,
        odometry=command_rows(own, rng),
        stamps=START + np.round(frames[frame], 3),
        barcodes=code,
        sightings=np.column_stack([r, b]),
        truth=truth,
    )


def camera_frames(
    pose: Float[np.ndarray, "f 3"],
    targets: Float[np.ndarray, "f n 2"],
    k: int,
    own: Drive,
    noise: float,
    rng: np.random.Generator,
) -> tuple[Bool[np.ndarray, "f n"], Float[np.ndarray, "f n"], Float[np.ndarray, "f n"]]:
    """Which target every frame shows, and every range and bearing as the camera of robot k would tell it."""
    d = targets - pose[:, None, :2]
    r = np.hypot(d[..., 0], d[..., 1])
    b = se2.wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - pose[:, None, 2])
    seen = (np.abs(b) < FIELD_OF_VIEW) & (r > NEAREST) & (r < FARTHEST) & (rng.random(r.shape) < SEEN)
    seen[:, k] = False
    sigma = np.hypot(RANGE_FLOOR, RANGE_SLOPE * r)
    e_r = _remembered(r.shape, RANGE_MEMORY, RANGE_WHITE, rng)
    e_b = _remembered(r.shape, BEARING_MEMORY, BEARING_WHITE, rng)
    measured = own.range_scale * r + noise * sigma * e_r
    return seen, np.maximum(measured, 0.05), se2.wrap_angle(b + own.bearing_bias + noise * BEARING_SIGMA * e_b)


def _remembered(shape: tuple[int, ...], memory: float, white: float, rng: np.random.Generator) -> np.ndarray:
    """Errors of unit variance along axis 0, each column its own: a share `white`, the rest fading over `memory`."""
    from scipy.signal import lfilter  # noqa: PLC0415  (costs half a second; simulated logs alone need it)

    a = np.exp(-FRAME / memory)
    drive = rng.normal(size=shape)
    drive[1:] *= np.sqrt(1 - a * a)
    slow = lfilter([1.0], [1.0, -a], drive, axis=0)
    return np.asarray(np.sqrt(1 - white) * slow + np.sqrt(white) * rng.normal(size=shape))


def command_rows(own: Drive, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """The command rows as logged: stamps in milliseconds, a few lost for up to a second, a few repeated."""
    keep = np.ones(len(own.t), bool)
    for _ in range(int(rng.poisson(own.t[-1] / 120.0))):
        first = int(rng.integers(1, len(own.t)))
        keep[first : first + int(rng.uniform(0.2, 1.0) / COMMAND_STEP)] = False
    rows = np.column_stack([START + np.round(own.t, 3), own.command])[keep]
    again = np.sort(rng.choice(len(rows), min(5, len(rows)), replace=False))
    return np.insert(rows, again, rows[again], axis=0)


START_RADIUS = 5.0  # [m], of the circle on which teams start unless said
# the paper's field: corners [m] and landmarks
YUAN_LOWER, YUAN_UPPER, YUAN_LANDMARKS = (-50.0, -40.0), (50.0, 40.0), 29


@dataclass(frozen=True, slots=True)
class Field:
    """A rectangle `lower`..`upper` [m] with landmarks (n, 2), named by their row, and the robots' starts (M, 3)."""

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    landmarks: Float[np.ndarray, "n 2"]
    starts: Float[np.ndarray, "r 3"]
    walls: Walls | None = None

    def __post_init__(self) -> None:
        freeze(self, "lower", "upper", "landmarks", "starts")
        if len(self.landmarks) == 0:
            raise DataError("the scenario has no landmarks: there is nothing to map")
        if len(self.starts) == 0:
            raise DataError("the scenario has no robots")
        for what, points in (("landmark", self.landmarks), ("robot", self.starts[:, :2])):
            outside = np.flatnonzero(~self.inside(points))
            if len(outside):
                x, y = points[outside[0]]
                raise DataError(f"{what} {outside[0] + 1} at ({x:g}, {y:g}) lies outside the field")
            if self.walls is not None:
                walled = np.flatnonzero(self.walls.clearance(points) <= 0.0)
                if len(walled):
                    x, y = points[walled[0]]
                    raise DataError(f"{what} {walled[0] + 1} at ({x:g}, {y:g}) lies inside a wall")

    def inside(self, points: Float[np.ndarray, "... 2"]) -> np.ndarray:
        """Which of `points` lie in the field."""
        return np.asarray(np.all((points >= self.lower) & (points <= self.upper), axis=-1))


def circle_of_starts(robots: int, radius: float = START_RADIUS) -> Float[np.ndarray, "r 3"]:
    """Starts of a team: the origin for one robot, else evenly on a circle facing out (the paper's two for two)."""
    if robots == 1:
        return np.zeros((1, 3))
    angle = np.pi + 2 * np.pi * np.arange(robots) / robots
    heading = np.arctan2(np.sin(angle), np.cos(angle))
    heading[0] = np.pi
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), heading], axis=-1)
