"""Where known ground ends: frontiers that a robot can get to, in pieces that make good goals."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...laser.occupancy_mapper import Occupancy
from ..ground import Ground, nearest_cells
from .config import LaserPlan

FRONTIER_SPLIT = 2.5  # [m], longest side of a piece of frontier that makes one goal
MOST_GOALS = 40  # considered at once; longer frontiers are cut into larger pieces

EIGHT = np.ones((3, 3), dtype=bool)
GOALS_SNAP = 1.0  # [m] within which a place off the ground counts as its nearest cell
SHARED_WALL_COST = 4  # what a metre of path by a wall counts beside one in the open, 1 to 255
ROOMY = 0.6  # [m] from walls, where a path costs no more than its length
SLIVER = 0.15  # [m^2], unknown patches smaller than this are nobody's goal: four cells


@dataclass(frozen=True, slots=True)
class Frontier:
    """One piece of frontier. place: (2,) [m], one of its cells, where a robot can be; unknown: (k, 2) cell centres
    [m] that are to be seen; size: cells of frontier.
    """

    place: Float[np.ndarray, "2"]
    unknown: Float[np.ndarray, "k 2"]
    size: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedGround(Ground):
    """The part of a map that the robots' discs get to.

    grid: the map; fits: cells (rows, cols) whose centre keeps the disc off everything occupied, known or not.
    """

    grid: Occupancy
    fits: Bool[np.ndarray, "rows cols"]


def mapped_ground(
    grid: Occupancy,
    places: Float[np.ndarray, "r 2"],
    obstacles: Float[np.ndarray, "k 2"],
    cfg: LaserPlan,
) -> MappedGround:
    """The ground that robots at `places` get to; `obstacles` are the places of dead robots."""
    blocked = grid.occupied
    if len(obstacles):
        blocked = blocked | disc_mask(grid, obstacles, cfg.radius)
    keep = cfg.radius + cfg.margin
    away = ndimage.distance_transform_edt(~blocked) * grid.resolution if blocked.any() else np.full(blocked.shape, 1e3)
    fits = away >= keep - 1e-9
    regions, _ = ndimage.label(fits & grid.free)
    stand = nearest_cells(regions > 0, grid.origin, grid.resolution, places, GOALS_SNAP)
    wanted = np.unique([regions[tuple(c)] for c in stand if c[0] >= 0])
    reach = np.isin(regions, wanted[wanted > 0]) if len(wanted) else np.zeros(fits.shape, dtype=bool)
    near_wall = np.clip((ROOMY - away) / max(ROOMY - keep, 1e-6), 0.0, 1.0)
    weight = np.where(reach, 1 + np.round((SHARED_WALL_COST - 1) * near_wall), 0).astype(np.uint8)
    return MappedGround(weight, grid.origin, grid.resolution, GOALS_SNAP, grid=grid, fits=fits)


def frontiers(ground: MappedGround) -> list[Frontier]:
    """Reached cells next to unknown ones where the disc might fit, cut into pieces of at most `split` metres.

    Unknown patches smaller than `SLIVER` do not count. Pieces grow until there are at most `most_goals`.
    """
    grid = ground.grid
    unknown = ground.fits & grid.unknown
    patches, count = ndimage.label(unknown, structure=EIGHT)
    if count:
        big = np.bincount(patches.ravel()) * grid.resolution**2 >= SLIVER - 1e-9
        big[0] = False
        unknown = big[patches]
    edge = ground.free & ndimage.binary_dilation(unknown, structure=EIGHT)
    cells = np.argwhere(edge)
    if len(cells) == 0:
        return []
    parts = ndimage.label(edge, structure=EIGHT)[0][edge]
    side, middle = FRONTIER_SPLIT, grid.centres(cells)
    while True:
        key = np.column_stack([parts, np.floor(middle / side).astype(np.int64)])
        piece = np.unique(key, axis=0, return_inverse=True)[1].ravel()
        if piece.max() < MOST_GOALS or side > 1e3:
            break
        side *= 1.5
    return [_piece(grid, unknown, cells[piece == k]) for k in range(piece.max() + 1)]


def _piece(grid: Occupancy, unknown: np.ndarray, cells: np.ndarray) -> Frontier:
    middle = grid.centres(cells)
    place = middle[np.argmin(np.hypot(*(middle - middle.mean(axis=0)).T))]
    rows, cols = unknown.shape
    low, high = np.maximum(cells.min(axis=0) - 1, 0), np.minimum(cells.max(axis=0) + 2, [rows, cols])
    mask = np.zeros(high - low, dtype=bool)
    mask[tuple((cells - low).T)] = True
    window = (slice(low[0], high[0]), slice(low[1], high[1]))
    beside = np.argwhere(ndimage.binary_dilation(mask, structure=EIGHT) & unknown[window]) + low
    return Frontier(place, grid.centres(beside), len(cells))


def pockets(ground: MappedGround) -> Float[np.ndarray, "n 2"]:
    """Middles (n, 2) [m] of patches known to be free, large enough to matter, that no robot gets to."""
    labels, count = ndimage.label(ground.grid.free & ground.fits & ~ground.free)
    if not count:
        return np.zeros((0, 2))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:] * ground.grid.resolution**2
    middles = np.array(ndimage.center_of_mass(labels > 0, labels, np.arange(1, count + 1))).reshape(-1, 2)
    kept = middles[sizes >= max(1.0, SLIVER)]
    return np.asarray(ground.grid.origin + (kept[:, ::-1] + 0.5) * ground.grid.resolution)


def disc_mask(grid: Occupancy, places: Float[np.ndarray, "n 2"], radius: float) -> Bool[np.ndarray, "rows cols"]:
    """Cells whose centre is within `radius` [m] of one of `places`, and the cells of the places themselves."""
    out = np.zeros(grid.state.shape, dtype=bool)
    span = int(np.ceil(radius / grid.resolution)) + 1
    offset = np.stack(np.meshgrid(np.arange(-span, span + 1), np.arange(-span, span + 1), indexing="ij"), axis=-1)
    cells = grid.cells(places)
    for cell, place in zip(cells, places, strict=True):
        near = cell + offset.reshape(-1, 2)
        near = near[np.all((near >= 0) & (near < out.shape), axis=1)]
        near = near[np.hypot(*(grid.centres(near) - place).T) <= radius]
        out[tuple(near.T)] = True
    out[tuple(cells.T)] = True
    return out
