"""The plain average of aligned maps: what one would do without covariances. The yardstick for all else."""

from collections.abc import Sequence

import numpy as np

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from .cluster import Cluster, JoinedMap

SWEEPS, STILL = 100, 1e-10


def average(maps: Sequence[LandmarkMap], start: Cluster) -> JoinedMap:
    """The equal-weight Procrustes mean of `maps` (those of `start.members`, in order).

    Each map is aligned, unweighted, to the mean, and the mean taken again, until nothing moves. The covariance is
    each map's own, carried through the mean as if the maps were independent and the alignments exact.
    """
    index = {name: i for i, name in enumerate(start.ids)}
    rows = [np.array([index[name] for name in m.ids], dtype=np.intp) for m in maps]
    count = np.zeros(len(start.ids))
    for at in rows:
        count[at] += 1
    mean, frames = start.points, start.frames
    for _ in range(SWEEPS):
        frames = np.stack([se2.align(m.mean, mean[at]) for m, at in zip(maps, rows, strict=True)])
        before, mean = mean, np.zeros_like(mean)
        for T, m, at in zip(frames, maps, rows, strict=True):
            mean[at] += se2.act(T, m.mean) / count[at, None]
        if np.abs(mean - before).max() < STILL:
            break
    T_ref_mean = se2.inverse(frames[0])
    frames, mean = se2.compose(T_ref_mean, frames), se2.act(T_ref_mean, mean)
    cov = np.zeros((2 * len(mean), 2 * len(mean)))
    chi2, frame_cov = 0.0, np.zeros((len(maps), 3, 3))
    for k, (T, m, at) in enumerate(zip(frames, maps, rows, strict=True)):
        C = np.kron(np.diag(1.0 / count[at]), se2.rotation(float(T[2])))
        both = (2 * at[:, None] + np.arange(2)).ravel()
        cov[np.ix_(both, both)] += C @ m.cov @ C.T
        e = se2.act(T, m.mean) - mean[at]
        chi2 += float(np.sum(e**2))
        frame_cov[k] = _alignment_cov(T, m, C * np.repeat(count[at], 2)[:, None]) if k else 0.0
    dof = sum(2 * len(at) for at in rows) - 2 * len(mean) - 3 * (len(maps) - 1)
    one = np.ones(len(maps))
    return JoinedMap(start.ids, mean, cov, frames, frame_cov, one, one, chi2, dof)


def _alignment_cov(T: np.ndarray, m: LandmarkMap, C: np.ndarray) -> np.ndarray:
    """The covariance of an unweighted alignment of a map whose points have the covariance they claim."""
    p = se2.act(T, m.mean) - T[:2]
    J = np.zeros((2 * len(p), 3))
    J[0::2, 0] = J[1::2, 1] = 1.0
    J[0::2, 2], J[1::2, 2] = -p[:, 1], p[:, 0]
    A = np.linalg.pinv(J)
    return np.asarray(A @ C @ m.cov @ C.T @ A.T)
