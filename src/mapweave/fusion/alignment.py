"""Rigid alignment of two point sets that survives wrong points: hypotheses from pairs, inliers, refit."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2

Points = Float[np.ndarray, "n 2"]
HYPOTHESES = 600


@dataclass(frozen=True, slots=True)
class RigidFit:
    """`T_target_source` (no scale, no reflection); residual: (n,) left [m]; inliers: (n,) under the gate."""

    T_target_source: Float[np.ndarray, "3"]
    residual: Float[np.ndarray, " n"]
    inliers: Bool[np.ndarray, " n"]

    @property
    def median(self) -> float:
        """The median distance left [m]."""
        return float(np.median(self.residual))


def align_robust(source: Points, target: Points, gate: Float[np.ndarray, " n"]) -> RigidFit:
    """The rigid transform under which most of n >= 2 corresponding points agree within their `gate` (n,) [m].

    Every pair of points (a spread of them when there are many) proposes a transform; the one of least truncated
    squared distance is refitted to its inliers. Exact for clean points, unmoved by a minority of wrong ones.
    """
    i, j = _pairs(len(source))
    s, t = _complex(source), _complex(target)
    turn = _unit((t[j] - t[i]) * np.conj(s[j] - s[i]))
    shift = 0.5 * (t[i] + t[j]) - turn * 0.5 * (s[i] + s[j])
    distance = np.abs(turn[:, None] * s + shift[:, None] - t)
    best = int(np.argmin(np.minimum((distance / gate) ** 2, 1.0).sum(axis=1)))
    residual, T = distance[best], se2.pose(shift[best].real, shift[best].imag, float(np.angle(turn[best])))
    inliers = residual < gate
    for _ in range(10):
        if inliers.sum() < 2:
            break
        T = se2.align(source[inliers], target[inliers])
        residual = np.hypot(*(se2.act(T, source) - target).T)
        before, inliers = inliers, residual < gate
        if np.array_equal(before, inliers):
            break
    return RigidFit(T, residual, inliers)


def _pairs(n: int) -> tuple[Int[np.ndarray, " h"], Int[np.ndarray, " h"]]:
    """All pairs of n things, or about `HYPOTHESES` of them with every thing in as many."""
    if n * (n - 1) // 2 <= HYPOTHESES:
        i, j = np.triu_indices(n, 1)
        return i, j
    steps = np.unique(np.linspace(1, n // 2, max(1, HYPOTHESES // n), dtype=np.intp))
    i = np.repeat(np.arange(n), len(steps))
    return i, (i + np.tile(steps, n)) % n


def _complex(points: Points) -> np.ndarray:
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def _unit(z: np.ndarray) -> np.ndarray:
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1.0), 1.0)
