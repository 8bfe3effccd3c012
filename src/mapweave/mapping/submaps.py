"""Submaps: what was seen from a piece of a segment, small enough never to bend, and its signature.

A submap is made of keyframes in a row as scan odometry laid them, so that it is the same whenever it is made and
whatever loops were closed since.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int

from ..core import se2
from ..core.records import freeze, frozen
from ..core.rows import spread
from ..kernels.laser.place_search import fit_normals
from ..laser.scan_matching import BINS, spectrum

SUBMAP_EVERY = 3.0  # [m] of way between the middles of submaps
SUBMAP_AROUND = 3.0  # [m] of way to either side that a submap is made of
SUBMAP_REACH = 20.0  # [m] farther returns are left out
SUBMAP_POINTS = 400  # of a submap that are searched for elsewhere, at most

VOXEL = 0.1  # [m] a side: one point of a submap
LINE = 0.2  # [m] points this near make a wall's line
TURN_WAY = 0.3  # [m] of way that a radian of turning counts as
LEAST_POINTS = 30  # of a submap


@dataclass(frozen=True, slots=True)
class PlaceSubmap:
    """The walls seen from keyframes first to last (both in it), in the frame of keyframe `anchor`.

    points: (n, 2) [m], one a square of `VOXEL`; q: (n,) their brightness or None; thin: which rows are searched for
    elsewhere; signature: (BINS / 2 + 1,) spectrum of the directions that walls face, mean off, unit norm.
    """

    anchor: int
    first: int
    last: int
    points: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"] | None
    thin: Int[np.ndarray, " m"]
    signature: Complex[np.ndarray, " f"]

    def __post_init__(self) -> None:
        freeze(self, "points")
        object.__setattr__(self, "q", None if self.q is None else frozen(self.q))


def way_of(local: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """[m] driven up to each of these poses, turning counted."""
    step = se2.between(local[:-1], local[1:])
    each = np.hypot(step[:, 0], step[:, 1]) + TURN_WAY * np.abs(step[:, 2])
    return np.concatenate([np.zeros(min(len(local), 1)), np.cumsum(each)])


def middles(way: Float[np.ndarray, " n"]) -> list[int]:
    """The keyframes of one segment that submaps are made around: one every so many metres of its way, one at least."""
    length = float(way[-1] - way[0])
    half = 0.5 * SUBMAP_EVERY
    asked = np.arange(half, length, SUBMAP_EVERY) if length > half else np.array([0.5 * length])
    return sorted({int(np.argmin(np.abs(way - way[0] - at))) for at in asked})


def extent(way: Float[np.ndarray, " n"], anchor: int) -> tuple[int, int]:
    """The first and the last keyframe of one segment that the submap around `anchor` is made of."""
    low = int(np.searchsorted(way, way[anchor] - SUBMAP_AROUND))
    return low, int(np.searchsorted(way, way[anchor] + SUBMAP_AROUND, side="right")) - 1


def make_submap(
    anchor: int,
    first: int,
    poses: Float[np.ndarray, "k 3"],
    points: Sequence[Float[np.ndarray, "_ 2"]],
    q: Sequence[Float[np.ndarray, " _"]] | None,
) -> PlaceSubmap | None:
    """The submap of k keyframes, `first` and those after it, in the frame of keyframe `anchor`.

    poses: of each as scan odometry has it, in one frame; points [m] and brightness q of each in its own frame. None
    where too little was seen.
    """
    seen, facing, light = [], [], []
    for k, pose in enumerate(se2.between(poses[anchor - first], poses)):
        far = np.hypot(points[k][:, 0], points[k][:, 1])
        near = far < SUBMAP_REACH
        back = -points[k][near] / np.maximum(far[near], VOXEL)[:, None]
        seen.append(se2.act(pose, points[k][near]))
        facing.append(back @ se2.rotation(float(pose[2])).T)
        if q is not None:
            light.append(q[k][near])
    cloud, sums, bright = _thinned(np.concatenate(seen), np.concatenate(facing), light)
    if len(cloud) < LEAST_POINTS:
        return None
    last = first + len(poses) - 1
    return PlaceSubmap(anchor, first, last, cloud, bright, spread(len(cloud), SUBMAP_POINTS), signature(cloud, sums))


def _thinned(
    points: np.ndarray, facing: np.ndarray, light: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """One point a square: the mean of those in it, the sum of their `facing`, their mean brightness."""
    if not len(points):
        return points, facing, np.concatenate(light) if light else None
    at = np.floor(points / VOXEL).astype(np.int64)
    at -= at.min(axis=0)
    _, which, count = np.unique(
        at[:, 1] * (int(at[:, 0].max()) + 1) + at[:, 0], return_inverse=True, return_counts=True
    )
    mean = np.column_stack([np.bincount(which, points[:, a]) / count for a in range(2)])
    sums = np.column_stack([np.bincount(which, facing[:, a]) for a in range(2)])
    return mean, sums, np.bincount(which, np.concatenate(light)) / count if light else None


def signature(points: Float[np.ndarray, "n 2"], facing: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, " f"]:
    """The spectrum of how much wall faces each direction, by the lines through `points`.

    facing: towards where each was seen from, of any length.
    """
    lines = fit_normals(frozen(points), LINE)
    side = np.where((lines[:, :2] * facing).sum(axis=1) < 0.0, -1.0, 1.0)
    at = np.arctan2(side * lines[:, 1], side * lines[:, 0]) / (2.0 * np.pi) * BINS % BINS
    low, weight = np.floor(at).astype(np.int64), np.square(1.0 - np.clip(lines[:, 2], 0.0, 1.0))
    amount = np.bincount(low % BINS, weight * (low + 1 - at), BINS) + np.bincount(
        (low + 1) % BINS, weight * (at - low), BINS
    )
    found = spectrum(amount)
    size = float(np.linalg.norm(np.fft.irfft(found, BINS)))
    return np.asarray(found / max(size, 1e-12))
