"""Trajectories against truth: ATE under a given alignment, RPE under none."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.records import Track

THIN = 1.0  # [s] between truth poses that count, where truth is dense


def scored_stamps(truth: Track, estimate: Track, *, dense: bool) -> Int[np.ndarray, " k"]:
    """Which truth poses count: inside the estimate's span, and where truth is dense the first of every second."""
    if not len(estimate.t):
        return np.zeros(0, np.int64)
    where = np.flatnonzero((truth.t >= estimate.t[0]) & (truth.t <= estimate.t[-1])).astype(np.int64)
    if not dense or not len(where):
        return where
    second = np.floor((truth.t[where] - truth.t[where[0]]) / THIN)
    return np.asarray(where[np.diff(second, prepend=-1.0) > 0])


def paired(
    estimate: Track, truth: Track, *, dense: bool
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Estimated poses (interpolated) and true poses at the stamps that count, and those stamps [s]."""
    where = scored_stamps(truth, estimate, dense=dense)
    if not len(where):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    t = truth.t[where]
    return se2.interpolate(t, estimate.t, estimate.pose), truth.pose[where], t


def align_tracks(pairs: Sequence[tuple[Track, Track, bool]]) -> Float[np.ndarray, "3"] | None:
    """`T_truth_map` fitted to all (estimate, truth, dense) together, every pose counting once; None without two."""
    both = [paired(estimate, truth, dense=dense)[:2] for estimate, truth, dense in pairs]
    estimated = np.concatenate([e[:, :2] for e, _ in both]) if both else np.zeros((0, 2))
    true = np.concatenate([t[:, :2] for _, t in both]) if both else np.zeros((0, 2))
    return se2.align(estimated, true) if len(true) > 1 else None


def ate(estimate: Track, truth: Track, T_truth_map: Float[np.ndarray, "3"], *, dense: bool) -> tuple[float | None, int]:
    """RMS position error [m] under the alignment given, and over how many poses."""
    ours, true, _ = paired(estimate, truth, dense=dense)
    if not len(true):
        return None, 0
    error = se2.act(T_truth_map, ours[:, :2]) - true[:, :2]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), len(true)


def rpe(estimate: Track, truth: Track, seconds: float, *, dense: bool) -> tuple[float | None, float | None]:
    """RMS drift over stretches of about `seconds`: metres and radians; needs no alignment."""
    ours, true, t = paired(estimate, truth, dense=dense)
    if not len(t):
        return None, None
    later = np.searchsorted(t, t + seconds)
    first = np.flatnonzero(later < len(t))
    first = first[t[later[first]] - t[first] < 1.5 * seconds]
    if not len(first):
        return None, None
    last = later[first]
    d = se2.between(se2.between(true[first], true[last]), se2.between(ours[first], ours[last]))
    return float(np.sqrt(np.mean(d[:, 0] ** 2 + d[:, 1] ** 2))), float(np.sqrt(np.mean(d[:, 2] ** 2)))
