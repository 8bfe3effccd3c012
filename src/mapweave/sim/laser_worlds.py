"""Worlds that are driven with a laser: an office room by room, a ring of corridor, a long tunnel."""

from dataclasses import field
from itertools import pairwise

import numpy as np

from ..core.config import config
from .laser import (
    DriftConfig,
    DriveConfig,
    LaserSimulation,
    LaserWorld,
    Route,
    Stretch,
    WallStyle,
    WorldBuilder,
    drive,
    ring,
    stream,
    through,
)


@config
class CorridorConfig:
    """The ring of [Hara07]'s kind: two long legs that are flush, two short ones with recessed doors."""

    long_leg: float = 60.0  # [m] along the middle of a long side of the ring
    short_leg: float = 30.0  # [m] along the middle of a short side of the ring
    width: float = 2.5  # [m] from wall to wall
    recess: float = 0.12  # [m] doors of the short legs stand back
    distance: float = 200.0  # [m] driven
    corner: float = 1.2  # [m] radius of the driven corners
    start: float = 15.0  # [m] after the first corner of a long leg, where the drive begins
    style: WallStyle = WallStyle()
    drive: DriveConfig = field(default_factory=DriveConfig)


def corridor_world(cfg: CorridorConfig, seed: int) -> LaserWorld:
    """The walls, in the frame of the robot's first pose."""
    build = WorldBuilder("corridor", cfg.style, stream(seed, "walls"))
    half = 0.5 * cfg.width
    for side in (half, -half):  # the outer wall runs round to the left, the inner one to the right
        x0, y0, x1, y1 = -cfg.start - side, -side, cfg.long_leg - cfg.start + side, cfg.short_leg + side
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
        if side < 0:
            corners.reverse()
        for a, b in pairwise(corners):
            build.wall(a, b, recess=0.0 if a[1] == b[1] else cfg.recess)
    return build.world()


def simulate_corridor(cfg: CorridorConfig | None = None, seed: int = 0) -> LaserSimulation:
    """One drive round the ring and on, over the place where it began."""
    cfg = cfg or CorridorConfig()
    route = ring(cfg.long_leg, cfg.short_leg, cfg.corner, cfg.distance, cfg.start)
    return drive(corridor_world(cfg, seed), route, cfg.drive, seed)


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
