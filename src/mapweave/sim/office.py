"""An office floor: rooms with desks on both sides of a corridor, driven room by room."""

from dataclasses import field

import numpy as np

from ..core.config import config
from .drift import DriftConfig
from .laser import DriveConfig, LaserSimulation, drive, stream
from .laser_world import LaserWorld, WallStyle, WorldBuilder
from .route import Route, through

DOORWAY = 1.0  # [m]


@config
class OfficeConfig:
    """An office floor to drive through with a laser: a corridor, rooms on either side, some of them visited."""

    rooms: int = 4  # on each side of the corridor
    room_width: float = 5.0  # [m] along the corridor
    room_depth: float = 4.5  # [m] away from it
    corridor: float = 2.2  # [m]
    visited: int = 5  # rooms driven into, at most all
    style: WallStyle = WallStyle(gap=(0.6, 2.0))
    drive: DriveConfig = field(default_factory=lambda: DriveConfig(drift=DriftConfig(end_error=(2.0, 4.0))))


def office_world(cfg: OfficeConfig, seed: int) -> LaserWorld:
    """The walls; the corridor runs along x with its middle on y = 0, the first room begins at x = 0."""
    rng = stream(seed, "walls")
    build = WorldBuilder("office", cfg.style, rng)
    half, length, far = 0.5 * cfg.corridor, cfg.rooms * cfg.room_width, 0.5 * cfg.corridor + cfg.room_depth
    build.wall((0.0, half), (0.0, -half))
    build.wall((length, -half), (length, half))
    for side in (1.0, -1.0):
        for k in range(cfg.rooms):
            x0, x1 = k * cfg.room_width, (k + 1) * cfg.room_width
            door = 0.5 * (x0 + x1)
            for a, b in ((x0, door - 0.5 * DOORWAY), (door + 0.5 * DOORWAY, x1)):
                for y in (half, half + 0.1):
                    build.wall((a, side * y), (b, side * y))
            for jamb in (door - 0.5 * DOORWAY, door + 0.5 * DOORWAY):
                build.plain((jamb, side * half), (jamb, side * (half + 0.1)), 0.4)
            build.wall((x0, side * (half + 0.1)), (x0, side * far))
            build.wall((x1, side * (half + 0.1)), (x1, side * far))
            build.wall((x0, side * far), (x1, side * far))
            _furnish(build, rng, x0, side, far, cfg)
    return build.world()


def _furnish(
    build: WorldBuilder, rng: np.random.Generator, x0: float, side: float, far: float, cfg: OfficeConfig
) -> None:
    """Desks along the far wall and a cabinet by the side, clear of where the robot goes."""
    for x in (x0 + 0.1, x0 + cfg.room_width - 1.5):
        if rng.random() < 0.8:
            deep = float(rng.uniform(0.5, 0.8))
            build.box(x, min(side * far, side * (far - deep)), 1.4, deep, float(rng.uniform(0.2, 0.7)))
    if rng.random() < 0.7:
        y = side * (far - float(rng.uniform(1.6, 2.2)))
        build.box(x0 + 0.02, y, 0.4, 0.5, float(rng.uniform(0.1, 0.9)))


def office_route(cfg: OfficeConfig, seed: int) -> Route:
    """Along the corridor, into `visited` rooms chosen by chance, round in each, and back to the start."""
    rng = stream(seed, "rooms")
    every = [(k, side) for k in range(cfg.rooms) for side in (1, -1)]
    chosen = sorted(rng.choice(len(every), min(cfg.visited, len(every)), replace=False).tolist())
    half = 0.5 * cfg.corridor
    points = [(0.8, 0.0)]
    for k, side in (every[c] for c in chosen):
        x = (k + 0.5) * cfg.room_width
        near, far, wide = half + 0.8, half + cfg.room_depth - 1.7, 0.5 * cfg.room_width - 1.2
        inside = [
            (x, near),
            (x + wide, near),
            (x + wide, far),
            (x - wide, far),
            (x - wide, near + 0.5),
            (x - 0.3, near),
        ]
        points += [
            (x - 0.3, 0.1 * side),
            *((px, side * py) for px, py in inside),
            (x - 0.3, 0.3 * side),
            (x + 0.4, 0.0),
        ]
    end = cfg.rooms * cfg.room_width - 0.8
    points += [(end, -0.4), (end, 0.4), (0.8, 0.3)]
    return through(points, 0.35)


def simulate_office(cfg: OfficeConfig | None = None, seed: int = 0) -> LaserSimulation:
    """One round through the office, there and back along the corridor."""
    cfg = cfg or OfficeConfig()
    return drive(office_world(cfg, seed), office_route(cfg, seed), cfg.drive, seed)
