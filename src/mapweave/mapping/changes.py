"""What changed between two maps of one place: walls that stand where the other saw free floor.

A wall of one map has gone, or is new, where beams of the other went through its place and end nowhere near it; near is
what either map and the alignment leave unsure. Where the other saw nothing there is nothing to compare.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, label
from scipy.spatial import cKDTree

from ..core import se2
from ..core.records import Track, frozen
from ..laser.laser_map import GridMap
from .woven_map import WovenMap

NEAR = 0.2  # [m] from a wall of the other map, where both maps are exact, one is the same wall,
SDS = 2.0  # and so many standard deviations farther where they are not
WALL, FREE = 0.5, 0.2  # occupancy of a wall, and of floor: where people passed by is neither
RETURNS, PASSES = 3, 5  # of a wall's cell, and beams through a free one, at least
AROUND = 1  # cells round a wall's place that have to be free too
JOIN = 0.3  # [m] from each other at most, cells are of one change
LEAST = 0.25  # [m] along its longer side: less is an edge that one map draws a cell farther


@dataclass(frozen=True, slots=True)
class Change:
    """Walls that one map has and the other has not. kind: `new` or `gone`; lower, upper: (2,) corners [m]; cells: of
    its walls; sd: [m] of where the two maps put it to each other. All in the frame of the map before.
    """

    kind: str
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    cells: int
    sd: float


@dataclass(frozen=True, slots=True)
class Changes:
    """changes: the largest first; walls: of each kind the places of their cells (n, 2) [m]; share: of the area that
    either map knows, the part that both do. All in the frame of the map before.
    """

    changes: tuple[Change, ...]
    walls: dict[str, Float[np.ndarray, "_ 2"]]
    share: float


def changes_between(
    before: WovenMap, after: WovenMap, transform: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"]
) -> Changes:
    """What changed, where the map after lies at `transform` in the frame of the one before.

    covariance: of an error of the transform in the later map's frame.
    """
    back = se2.inverse(transform)
    found: list[Change] = []
    walls = {}
    for kind, here, other, T in (("gone", before, after, back), ("new", after, before, transform)):
        at = _walls(here.grid)
        there = np.asarray(se2.act(T, at))
        home = there if kind == "new" else at
        sd = _sd(before, after, home, np.asarray(se2.act(back, home)), covariance)
        lone = _free(other.grid, there)
        far, _ = cKDTree(_any_walls(other.grid)).query(there)
        lone &= np.asarray(far) > NEAR + SDS * sd
        number = _clusters(home, lone, here.grid.resolution)
        kept = np.zeros(len(home), dtype=bool)
        for k in range(1, int(number.max(initial=0)) + 1):
            rows = np.flatnonzero(number == k)
            lower, upper = home[rows].min(axis=0), home[rows].max(axis=0)
            if (upper - lower).max() < LEAST:
                continue
            kept[rows] = True
            found.append(Change(kind, frozen(lower), frozen(upper), len(rows), float(np.median(sd[rows]))))
        walls[kind] = frozen(home[kept])
    found.sort(key=lambda c: (-c.cells, *c.lower.tolist()))
    return Changes(tuple(found), walls, _share(before.grid, after.grid, back))


def _walls(grid: GridMap) -> Float[np.ndarray, "n 2"]:
    """Where the cells that are surely walls have their returns [m]."""
    rows, cols = np.nonzero((grid.occupancy() > WALL) & (grid.hits >= RETURNS))
    return grid.mean[rows, cols].astype(float)


def _any_walls(grid: GridMap) -> Float[np.ndarray, "n 2"]:
    """Where cells have their returns that may be walls [m], and a place far away: there is always one."""
    rows, cols = np.nonzero((grid.occupancy() > FREE) & (grid.hits > 0))
    return np.concatenate([grid.mean[rows, cols].astype(float), np.full((1, 2), 1e9)])


def cells_at(grid: GridMap, at: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Row and column of each place, and whether it lies on the grid; others are at its rim."""
    cell = np.floor((at - grid.origin) / grid.resolution).astype(np.int64)[:, ::-1]
    inside = ((cell >= 0) & (cell < grid.shape)).all(axis=1)
    return np.clip(cell, 0, np.array(grid.shape) - 1), inside


def _free(grid: GridMap, at: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Which places lie on floor that beams went through, and all around them."""
    clear = (grid.passes >= PASSES) & (grid.occupancy() < FREE)
    cell, inside = cells_at(grid, at)
    free = inside
    for dr in range(-AROUND, AROUND + 1):
        for dc in range(-AROUND, AROUND + 1):
            row, col = np.clip(cell + np.array([dr, dc]), 0, np.array(grid.shape) - 1).T
            free = free & clear[row, col]
    return free


def _sd(
    before: WovenMap,
    after: WovenMap,
    home: Float[np.ndarray, "n 2"],
    there: Float[np.ndarray, "n 2"],
    covariance: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, " n"]:
    """How unsure it is [m] where places of the two maps lie to each other: home, there: in the frame of either."""
    J = np.tile(np.eye(2, 3), (len(there), 1, 1))
    J[:, 0, 2], J[:, 1, 2] = -there[:, 1], there[:, 0]
    aligned = np.trace(J @ covariance @ J.swapaxes(1, 2), axis1=1, axis2=2) / 2
    return np.asarray(np.sqrt(aligned + _near(before, home) + _near(after, there)))


def _near(woven: WovenMap, at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Variance [m^2] along an axis of the robots' poses that are nearest to each place."""
    known = [track for track in woven.tracks.values() if track.cov is not None and len(track.t)]
    if not known or not len(at):
        return np.zeros(len(at))
    pose = np.concatenate([track.pose[:, :2] for track in known])
    var = np.concatenate([_variance(track) for track in known])
    return np.asarray(var[np.asarray(cKDTree(pose).query(at)[1])])


def _variance(track: Track) -> Float[np.ndarray, " n"]:
    assert track.cov is not None  # noqa: S101  (asked for by who calls)
    return np.asarray(np.trace(track.cov[:, :2, :2], axis1=1, axis2=2) / 2)


def _clusters(at: Float[np.ndarray, "n 2"], chosen: Bool[np.ndarray, " n"], cell: float) -> Int[np.ndarray, " n"]:
    """Which change each chosen place is of, from 1 on; 0 of the others."""
    number = np.zeros(len(at), dtype=np.int64)
    if not chosen.any():
        return number
    place = np.floor((at[chosen] - at[chosen].min(axis=0)) / cell).astype(np.int64) + 1
    picture = np.zeros(place.max(axis=0) + 2, dtype=bool)
    picture[tuple(place.T)] = True
    square = np.ones((3, 3), dtype=bool)
    wide = binary_dilation(picture, iterations=max(1, round(0.5 * JOIN / cell)), structure=square)
    number[chosen] = label(wide, structure=square)[0][tuple(place.T)]
    return number


def _share(before: GridMap, after: GridMap, back: Float[np.ndarray, "3"]) -> float:
    """Of the area [m^2] that either knows, the part that both do."""
    known = (before.hits > 0) | (before.passes > 0)
    other = (after.hits > 0) | (after.passes > 0)
    rows, cols = np.nonzero(known)
    at = before.origin + before.resolution * (np.column_stack([cols, rows]) + 0.5)
    cell, inside = cells_at(after, np.asarray(se2.act(back, at)))
    both = int((inside & other[tuple(cell.T)]).sum()) * before.resolution**2
    either = len(at) * before.resolution**2 + int(other.sum()) * after.resolution**2 - both
    return both / either if either > 0 else 0.0
