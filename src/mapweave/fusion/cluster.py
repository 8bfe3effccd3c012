"""Connected local maps: the initial guess of every method of joining, its result, and the equal-weight mean.

The average is what one would do without covariances: the yardstick for all else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap

ENOUGH = 2  # landmarks in common that fix a rigid transform


@dataclass(frozen=True, slots=True)
class Cluster:
    """Maps tied together by shared landmarks, and roughly where everything is.

    members: positions in the sequence of maps, ascending; frames: (k, 3) `T_ref_local` of each, ref being the first
    member's frame; ids, points: every landmark of the cluster, in order of first appearance, (n, 2) in ref;
    shared: (k,) how many of each member's landmarks another member has too.
    """

    members: tuple[int, ...]
    frames: Float[np.ndarray, "k 3"]
    ids: tuple[str, ...]
    points: Float[np.ndarray, "n 2"]
    shared: Int[np.ndarray, " k"]


@dataclass(frozen=True, slots=True)
class JoinedMap:
    """One cluster of k maps as one map of n landmarks, in the frame of its first member (the gauge).

    ids, mean: (n, 2) [m], cov: (2n, 2n); frames: (k, 3) `T_ref_local`, frame_cov: (k, 3, 3) over x, y, theta, zero
    for the first; scales: (k,) how many times too large each map was (1 where scale is not estimated);
    variance_factors: (k,); chi2 and dof of the residuals.
    """

    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frames: Float[np.ndarray, "k 3"]
    frame_cov: Float[np.ndarray, "k 3 3"]
    scales: Float[np.ndarray, " k"]
    variance_factors: Float[np.ndarray, " k"]
    chi2: float
    dof: int


def clusters(maps: Sequence[LandmarkMap]) -> tuple[Cluster, ...]:
    """The maps parted so that no two parts share two landmarks; the largest part first.

    Parts that share most are joined first, each time by a Procrustes fit over what they share, so the outcome does
    not depend on the order of the maps but for ties.
    """
    index = {name: i for i, name in enumerate(dict.fromkeys(name for m in maps for name in m.ids))}
    where = [np.array([index[name] for name in m.ids], dtype=np.intp) for m in maps]
    seen = np.zeros((len(maps), len(index)), dtype=np.float32)
    points = np.zeros((len(maps), len(index), 2))
    for k, m in enumerate(maps):
        seen[k, where[k]] = 1.0
        points[k, where[k]] = m.mean
    held = seen.copy()
    parts: list[dict[int, np.ndarray]] = [{k: np.zeros(3)} for k in range(len(maps))]
    overlap = seen @ seen.T
    np.fill_diagonal(overlap, 0)
    while len(maps) and overlap.max() >= ENOUGH:
        a, b = sorted(int(i) for i in np.unravel_index(int(np.argmax(overlap)), overlap.shape))
        common = (seen[a] > 0) & (seen[b] > 0)
        T_a_b = se2.align(points[b, common], points[a, common])
        parts[a] |= {k: se2.compose(T_a_b, T) for k, T in parts[b].items()}
        new = (seen[b] > 0) & ~common
        points[a, new] = se2.act(T_a_b, points[b, new])
        seen[a, new] = 1.0
        seen[b], parts[b] = 0.0, {}
        row = seen @ seen[a]
        row[a] = 0
        overlap[a], overlap[:, a] = row, row
        overlap[b], overlap[:, b] = 0, 0
    names = list(index)
    out = []
    for k, part in enumerate(parts):
        if part:
            members = tuple(sorted(part))
            T_ref_part = se2.inverse(part[members[0]])
            known = np.flatnonzero(seen[k])
            times = held[list(members)].sum(axis=0)
            out.append(
                Cluster(
                    members=members,
                    frames=np.stack([se2.compose(T_ref_part, part[i]) for i in members]),
                    ids=tuple(names[i] for i in known),
                    points=se2.act(T_ref_part, points[k, known]),
                    shared=np.array([np.count_nonzero(times[where[i]] > 1) for i in members]),
                )
            )
    return tuple(sorted(out, key=lambda c: (-len(c.members), c.members)))


SWEEPS, STILL = 100, 1e-10  # over all maps at most; [m] below which nothing moves any more


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
