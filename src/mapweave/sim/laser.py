"""A robot with a laser scanner driven through a world with people: its log, the truth, what the walls are."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track, frozen
from ..core.se2 import representable_heading
from ..kernels.walls.raycast import cast
from .drift import DriftConfig, drifted
from .laser_world import LaserWorld
from .route import Route
from .scanner import Reflectance, Scanner, measure

START_NS = 1_000_000_000_000  # logs begin at 1000 s


@config
class DriveConfig:
    """How the world is driven and seen."""

    scan_every: float = 0.25  # [m]
    odometry_every: float = 0.05  # [m]; a whole part of `scan_every`
    speed: float = 0.5  # [m/s]
    people: int = 0
    sensor_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # T_robot_sensor
    scanner: Scanner = Scanner()
    law: Reflectance = Reflectance()
    drift: DriftConfig = DriftConfig()


@dataclass(frozen=True, slots=True)
class LaserSimulation:
    """What was driven. truth: poses in the world's frame at every stamp of the log.

    reflectance: (m, n), the true one of what each beam of each scan hit, 0 where nothing came back.
    """

    log: LaserLog
    truth: Track
    reflectance: Float[np.ndarray, "m n"]
    world: LaserWorld
    heading_bias: float


def drive(world: LaserWorld, route: Route, cfg: DriveConfig, seed: int) -> LaserSimulation:
    """The log of one drive along `route`, the same for the same seed.

    Walls, odometry, scanner and people draw from streams of their own: changing one leaves the others as they were.
    """
    each = max(1, round(cfg.scan_every / cfg.odometry_every))
    step = cfg.scan_every / each
    s = step * np.arange(int(route.total / step + 1e-9) + 1)
    t = (START_NS + np.round(s / cfg.speed * 1e9).astype(np.int64)) / 1e9
    truth = route.poses(s)
    odometry, bias = drifted(truth, cfg.drift, stream(seed, "odometry"))
    x, y, theta = cfg.sensor_pose
    T_robot_sensor = frozen([x, y, representable_heading(theta)])
    at = np.arange(0, len(s), each)
    sensor = se2.compose(truth[at], T_robot_sensor)
    discs, clothes = walking(cfg.people, route, t[at], truth[at], stream(seed, "people"))
    true_range, what, cosine = cast(sensor, cfg.scanner.angles(), world.segments, discs, cfg.scanner.far + 0.3)
    surface = np.concatenate([world.reflectance, clothes, [0.0]])
    rho = surface[what]
    ranges, light = measure(true_range, what, cosine, rho, cfg.scanner, cfg.law, stream(seed, "scanner"))
    hit = ranges < cfg.scanner.range_max
    scans = tuple(
        Scan(
            frozen(ranges[k]),
            frozen(hit[k], dtype=bool),
            frozen(light[k]),
            cfg.scanner.angle_min,
            cfg.scanner.angle_increment,
            cfg.scanner.range_max,
            T_robot_sensor,
            "",
            frozen(odometry[i]),
        )
        for k, i in enumerate(at.tolist())
    )
    log = LaserLog("1", f"simulated {world.name}, seed {seed}", t[at], scans, Track(t, odometry, frame="odom"))
    return LaserSimulation(log, Track(t, truth, frame="world"), frozen(np.where(hit, rho, 0.0)), world, bias)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for each purpose."""
    return np.random.default_rng([seed, *purpose.encode()])


RADIUS, SPEED, ASIDE, APART = 0.22, (0.6, 1.4), 0.6, 0.6  # [m], [m/s], [m] off the line, [m] kept from the robot


def walking(
    count: int, route: Route, t: Float[np.ndarray, " m"], robot: Float[np.ndarray, "m 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "m d 3"], Float[np.ndarray, " d"]]:
    """Discs (m, d, 3) as x y radius at the times `t` [s], and the reflectance (d,) of their clothes.

    Each walks at its own speed between the ends of the route, turning round there; one that would stand in the robot
    is not there (radius 0).
    """
    total = route.total
    speed = rng.uniform(*SPEED, count) * np.where(rng.random(count) < 0.5, 1.0, -1.0)
    start, aside = rng.uniform(0, total, count), rng.uniform(-ASIDE, ASIDE, count)
    discs = np.zeros((len(t), count, 3))
    for k in range(count):
        way = np.abs((start[k] + speed[k] * (t - t[0]) + total) % (2 * total) - total)
        poses = route.poses(way)
        discs[:, k, 0] = poses[:, 0] - aside[k] * np.sin(poses[:, 2])
        discs[:, k, 1] = poses[:, 1] + aside[k] * np.cos(poses[:, 2])
        free = np.hypot(discs[:, k, 0] - robot[:, 0], discs[:, k, 1] - robot[:, 1]) > APART
        discs[:, k, 2] = np.where(free, RADIUS, 0.0)
    return discs, rng.uniform(0.1, 0.7, count)
