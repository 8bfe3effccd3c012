"""A ring of corridor where geometry alone hardly tells places apart, but paint, posters and doors do."""

from dataclasses import field
from itertools import pairwise

from ..core.config import config
from .laser import DriveConfig, LaserSimulation, drive, stream
from .laser_world import LaserWorld, WallStyle, WorldBuilder
from .route import ring


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
