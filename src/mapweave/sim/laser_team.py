"""A team of laser robots in one building: they drive, see walls and each other, and count wheels."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.config import config
from ..core.errors import DataError, EstimateError
from ..core.records import Scan, frozen
from ..core.se2 import representable_heading
from ..core.walls import WallIndex
from .laser import START_NS, LaserWorld, Reflectance, Scanner, measure, stream

SCALE_LENGTH = 15.0  # [m] over which it is correlated
ODOMETRY_NOISE_TRANSLATION = 0.01  # [m per sqrt(m)] of the place, along the path
ODOMETRY_NOISE_ROTATION = np.radians(0.4)  # [rad per sqrt(m)] of the heading, driving

ROBOT_REFLECTANCE = 0.35  # of another robot's hull, as `PAINT` is of a wall


@config
class OdometryNoise:
    """Errors of wheel odometry, each times `factor`."""

    factor: float = 1.0  # on all errors below
    scale: float = 0.01  # sd of the scale error, an Ornstein-Uhlenbeck process
    turning: float = np.radians(1.0)  # [rad per sqrt(rad)] of the heading, turning
    bias: float = np.radians(0.1)  # [rad/m], sd of each robot's own heading bias


@config
class LaserRobotsConfig:
    """Robots and sensors of a laser world."""

    radius: float = 0.2  # [m], a robot is a disc
    speed: float = 0.6  # [m/s], at most; no robot drives backwards faster than this either
    turn: float = 1.0  # [rad/s], at most
    period: float = 0.5  # [s] a step
    scanner: Scanner = Scanner(beams=360, opening=2 * np.pi * 359 / 360, far=12.0)
    law: Reflectance = Reflectance()
    odometry: OdometryNoise = OdometryNoise()


@dataclass(slots=True)
class LaserTeamSim:
    """The true team. It changes by `step` alone, and a seed gives the same run whatever is asked in between.

    starts: (M, 3) in the world's frame. true_poses: (M, 3) there; odometry: (M, 3), `T_odom_robot` of each robot from
    the origin; collisions: (M,) contacts with walls or robots so far: a robot that would touch is stopped short and
    counted once, until a step goes without contact. Scanner, odometry and each robot draw from streams of their own.
    """

    world: LaserWorld
    starts: Float[np.ndarray, "M 3"]
    cfg: LaserRobotsConfig = field(default_factory=LaserRobotsConfig)
    seed: int = 0
    steps: int = 0
    true_poses: Float[np.ndarray, "M 3"] = field(init=False)
    odometry: Float[np.ndarray, "M 3"] = field(init=False)
    collisions: Int[np.ndarray, " M"] = field(init=False)
    walls: WallIndex = field(init=False)
    _touching: np.ndarray = field(init=False)
    _wheels: "list[Wheels]" = field(init=False)

    def __post_init__(self) -> None:
        self.walls = WallIndex.of(self.world.segments)
        self.true_poses = np.array(self.starts, dtype=float).reshape(-1, 3)
        M = len(self.true_poses)
        if M < 1:
            raise DataError("there are no robots: nobody explores")
        check_starts(self.walls, self.true_poses, self.cfg.radius)
        self.odometry = np.zeros((M, 3))
        self.collisions = np.zeros(M, dtype=np.int64)
        self._touching = np.zeros(M, dtype=bool)
        self._wheels = [Wheels(self.cfg.odometry, stream(self.seed, f"odometry {j}")) for j in range(M)]

    @property
    def t(self) -> float:
        """The stamp [s] of now, a whole number of nanoseconds."""
        return (START_NS + round(self.steps * self.cfg.period * 1e9)) / 1e9

    def step(self, commands: Float[np.ndarray, "M 2"]) -> None:
        """All robots drive arcs (v [m/s], w [rad/s]) for one period, side by side."""
        u = np.asarray(commands, dtype=float)
        if u.shape != (len(self.true_poses), 2) or not np.isfinite(u).all():
            raise EstimateError(f"commands must be {len(self.true_poses)} x 2 finite numbers, found shape {u.shape}")
        u = np.clip(u, [-self.cfg.speed, -self.cfg.turn], [self.cfg.speed, self.cfg.turn])
        after, stopped = self.walls.drive(self.true_poses, u, self.cfg.period, self.cfg.radius)
        after[:, 2] = se2.wrap_angle(after[:, 2])
        self.collisions += stopped & ~self._touching
        self._touching = stopped
        twist = se2.log(se2.between(self.true_poses, after))
        for j, wheels in enumerate(self._wheels):
            pose = se2.compose(self.odometry[j], se2.exp(wheels.turned(twist[j])))
            self.odometry[j] = (*pose[:2], representable_heading(float(pose[2])))
        self.true_poses = after
        self.steps += 1

    def scan(self, j: int) -> Scan:
        """What robot j sees now; the same however often it is asked."""
        cfg = self.cfg
        others = np.delete(self.true_poses[:, :2], j, axis=0)
        discs = np.column_stack([others, np.full(len(others), cfg.radius)])[None]
        true_range, what, cosine = self.walls.cast(
            self.true_poses[j : j + 1], cfg.scanner.angles(), discs, cfg.scanner.far + 0.3
        )
        surface = np.concatenate([self.world.reflectance, np.full(len(others), ROBOT_REFLECTANCE), [0.0]])
        rng = np.random.default_rng([self.seed, *b"scanner", j, self.steps])
        ranges, light = measure(true_range, what, cosine, surface[what], cfg.scanner, cfg.law, rng)
        return Scan(
            frozen(ranges[0]),
            frozen(ranges[0] < cfg.scanner.range_max, dtype=bool),
            frozen(light[0]),
            cfg.scanner.angle_min,
            cfg.scanner.angle_increment,
            cfg.scanner.range_max,
            odometry=frozen(self.odometry[j].copy()),
        )


def check_starts(walls: WallIndex, starts: Float[np.ndarray, "M 3"], radius: float) -> None:
    """Raises DataError when a robot would start in a wall or in another robot."""
    for j in np.flatnonzero(walls.touches(starts[:, :2], radius)).tolist():
        x, y = starts[j, :2]
        raise DataError(f"robot{j + 1} would start in a wall at ({x:g}, {y:g}): it needs {radius:g} m all round")
    for j in range(len(starts)):
        for k in range(j):
            if np.hypot(*(starts[j, :2] - starts[k, :2])) < 2 * radius:
                raise DataError(f"robot{k + 1} and robot{j + 1} would start in each other")


class Wheels:
    """One robot's odometry errors along its path."""

    def __init__(self, cfg: OdometryNoise, rng: np.random.Generator) -> None:
        self.cfg, self.rng = cfg, rng
        self.bias = cfg.factor * cfg.bias * float(rng.standard_normal())
        self.scale = cfg.factor * cfg.scale * float(rng.standard_normal())

    def turned(self, twist: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The twist the wheels tell for the true one."""
        c = self.cfg
        shock = self.rng.standard_normal(4)
        ds, turn = abs(float(twist[0])), abs(float(twist[2]))
        keep = float(np.exp(-ds / SCALE_LENGTH))
        self.scale = self.scale * keep + c.factor * c.scale * np.sqrt(1.0 - keep * keep) * shock[3]
        slip = c.factor * ODOMETRY_NOISE_TRANSLATION * np.sqrt(ds)
        sd = c.factor * np.sqrt(ODOMETRY_NOISE_ROTATION**2 * ds + c.turning**2 * turn)
        return np.array(
            [
                twist[0] * (1.0 + self.scale) + slip * shock[0],
                twist[1] + slip * shock[1],
                twist[2] + self.bias * ds + sd * shock[2],
            ]
        )
