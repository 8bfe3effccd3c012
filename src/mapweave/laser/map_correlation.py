"""How two whole maps may lie on each other: every turn and shift, by what both saw as walls and as free floor.

Walls that fall on walls speak for a place, walls that fall where the other robot saw free floor speak against it. Over
all shifts at once that is a correlation, so a Fourier transform a heading gives all of them; unlike a search for parts,
it finds places where the maps share little, and every other place that the maps would allow too.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import fft
from scipy.ndimage import binary_dilation

from ..core import se2
from ..core.config import config
from .map_overlap import KeyframeMap

MARGIN = 2.0  # [m] round a map's raster
MOST = 1_000_000  # cells of a correlation; larger maps get larger cells


@config
class CorrelationConfig:
    """How whole maps are laid on each other."""

    cell: float = 0.3  # [m] side of the cells that walls and free floor are laid on
    turn: float = 0.03490658503988659  # [rad] between headings, 2 degrees
    through: float = 3.0  # walls on walls that a wall on free floor outweighs
    reach: float = 10.0  # [m] from a keyframe that a beam makes floor free,
    short: float = 0.5  # [m] less than its range
    places: int = 10  # handed over at most,
    apart: float = 1.5  # [m] that two places lie apart at least, or
    apart_turn: float = 0.25  # [rad] are turned, and
    least: float = 0.15  # of the best one's score


class MapPlace(NamedTuple):
    """Map b at `transform` in map a; score: cells of walls that agree less those that contradict."""

    transform: Float[np.ndarray, "3"]
    score: float


class _Raster(NamedTuple):
    walls: Bool[np.ndarray, "c r"]
    free: Bool[np.ndarray, "c r"]
    lower: Float[np.ndarray, "2"]


def map_places(a: KeyframeMap, b: KeyframeMap, cfg: CorrelationConfig) -> list[MapPlace]:
    """The places of map b in map a that score most, the best first."""
    if not len(a.walls) or not len(b.walls):
        return []
    span = float(np.prod(np.ptp(a.walls, axis=0) + 2.0 * np.hypot(*np.ptp(b.walls, axis=0))))
    cell = max(cfg.cell, float(np.sqrt(span / MOST)))
    one, other = _raster(a, cell, cfg), _raster(b, cell, cfg)
    walls, free = (other.lower + (np.argwhere(m) + 0.5) * cell for m in (other.walls, other.free))
    middle = walls.mean(axis=0)
    walls, free = walls - middle, free - middle
    radius = float(np.hypot(*np.concatenate([walls, free]).T).max()) + cell
    size = int(np.ceil(2.0 * radius / cell)) + 1
    shape = [fft.next_fast_len(n + size, real=True) for n in one.walls.shape]
    beneath = binary_dilation(one.walls).astype(np.float32) - cfg.through * one.free.astype(np.float32)
    of_walls = fft.rfft2(beneath, shape)
    of_free = fft.rfft2(-cfg.through * one.walls.astype(np.float32), shape)
    candidates: list[tuple[float, float, int, int]] = []
    for heading in np.arange(0.0, 2.0 * np.pi, cfg.turn).tolist():
        turn = se2.rotation(heading).T
        stood = fft.rfft2(_stamped(walls @ turn, radius, cell, shape))
        seen = fft.rfft2(_stamped(free @ turn, radius, cell, shape))
        spectrum = of_walls * stood.conj() + of_free * seen.conj()
        score = np.roll(fft.irfft2(spectrum, shape), (size, size), (0, 1)).ravel()
        most = np.argpartition(score, -3 * cfg.places)[-3 * cfg.places :].tolist()
        candidates += [(-float(score[k]), heading, k // shape[1] - size, k % shape[1] - size) for k in most]
    return _apart(sorted(candidates), one.lower + radius, middle, cell, cfg)


def _apart(
    candidates: list[tuple[float, float, int, int]],
    corner: np.ndarray,
    middle: np.ndarray,
    cell: float,
    cfg: CorrelationConfig,
) -> list[MapPlace]:
    """The best of every place, in b's own frame. corner: where a shift of zero puts the middle of b's walls in a."""
    out: list[MapPlace] = []
    held: list[np.ndarray] = []
    for score, heading, u, v in candidates:
        if len(out) == cfg.places or -score <= cfg.least * max(-candidates[0][0], 0.0):
            break
        at = np.array([*(corner + cell * np.array([u, v])), heading])
        near = (
            np.hypot(*(at - h)[:2]) <= cfg.apart and abs(se2.wrap_angle(at[2] - h[2])) <= cfg.apart_turn for h in held
        )
        if any(near):
            continue
        held.append(at)
        out.append(MapPlace(se2.compose(at, np.array([-middle[0], -middle[1], 0.0])), -score))
    return out


def _raster(m: KeyframeMap, cell: float, cfg: CorrelationConfig) -> _Raster:
    """Which cells hold walls and which a beam crossed, as columns and rows."""
    lower = np.minimum(m.walls.min(axis=0), m.pose[:, :2].min(axis=0)) - MARGIN
    upper = np.maximum(m.walls.max(axis=0), m.pose[:, :2].max(axis=0)) + MARGIN
    walls, free = (np.zeros(np.ceil((upper - lower) / cell).astype(int), dtype=bool) for _ in range(2))
    walls[tuple(np.floor((m.walls - lower) / cell).astype(int).T)] = True
    along = np.arange(0.0, cfg.reach, 0.7 * cell)
    for pose, points in zip(m.pose[::2], m.points[::2], strict=True):
        r = np.hypot(*points.T)
        crossed = np.minimum(along, np.clip(r - cfg.short, 0.0, cfg.reach)[:, None]) / np.maximum(r, 1e-9)[:, None]
        at = se2.act(pose, (points[:, None, :] * crossed[..., None]).reshape(-1, 2))
        inside = np.clip(np.floor((at - lower) / cell).astype(int), 0, np.array(free.shape) - 1)
        free[tuple(inside.T)] = True
    return _Raster(walls, free & ~binary_dilation(walls), lower)


def _stamped(points: np.ndarray, radius: float, cell: float, shape: list[int]) -> np.ndarray:
    """A raster of `shape` in which the cells with points are 1; the middle lies `radius` from its lower corner."""
    out = np.zeros(shape, np.float32)
    out[tuple(np.floor((points + radius) / cell).astype(int).T)] = 1.0
    return out
