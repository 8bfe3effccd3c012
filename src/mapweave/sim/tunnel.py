"""A long straight tunnel without any feature but reflective marks: the worst case of geometry alone."""

from dataclasses import field

import numpy as np

from ..core.config import config
from .drift import DriftConfig
from .laser import DriveConfig, LaserSimulation, drive, stream
from .laser_world import LaserWorld, Stretch, WallStyle, WorldBuilder
from .route import Route


@config
class TunnelConfig:
    """A long tunnel without features but reflective marks on its walls, driven down and back."""

    length: float = 80.0  # [m] from end to end
    width: float = 3.0  # [m] from wall to wall
    concrete: float = 0.35  # reflectance of the walls
    mark_gap: tuple[float, float] = (1.0, 4.0)  # [m] between marks on one side
    mark_width: tuple[float, float] = (0.1, 0.4)  # [m]
    mark: tuple[float, float] = (0.85, 1.0)  # reflectance of a mark, from to
    drive: DriveConfig = field(default_factory=lambda: DriveConfig(drift=DriftConfig(end_error=(3.0, 6.0))))


def tunnel_world(cfg: TunnelConfig, seed: int) -> LaserWorld:
    """The walls along x from -2 m on, the ends closed but out of sight for most of the way."""
    rng = stream(seed, "walls")
    build = WorldBuilder("tunnel", WallStyle(paint=cfg.concrete, mottle=0.02), rng)
    half, x0, x1 = 0.5 * cfg.width, -2.0, cfg.length - 2.0
    build.marked((x0, -half), (x1, -half), _marks(cfg, rng))
    build.plain((x1, -half), (x1, half))
    build.marked((x1, half), (x0, half), _marks(cfg, rng))
    build.plain((x0, half), (x0, -half))
    return build.world()


def _marks(cfg: TunnelConfig, rng: np.random.Generator) -> list[Stretch]:
    out: list[Stretch] = []
    at = float(rng.uniform(*cfg.mark_gap))
    while (end := at + float(rng.uniform(*cfg.mark_width))) < cfg.length:
        out.append((at, end, float(rng.uniform(*cfg.mark)), 0.0))
        at = end + float(rng.uniform(*cfg.mark_gap))
    return out


def tunnel_route(cfg: TunnelConfig) -> Route:
    """Down the tunnel, round at its end, and back past the start's marks."""
    turn = 0.3 * cfg.width
    straight = cfg.length - 4.0 - turn
    arc = (np.pi * turn, 1.0 / turn)
    start = np.array([0.0, -turn, 0.0])
    return Route(start, np.array([straight, arc[0], straight]), np.array([0.0, arc[1], 0.0]))


def simulate_tunnel(cfg: TunnelConfig | None = None, seed: int = 0) -> LaserSimulation:
    """There and back."""
    cfg = cfg or TunnelConfig()
    return drive(tunnel_world(cfg, seed), tunnel_route(cfg), cfg.drive, seed)
