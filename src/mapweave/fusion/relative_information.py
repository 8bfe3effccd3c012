"""Relative information: what a landmark map says in no frame at all, as a measurement with its Jacobian and noise.

A map with n landmarks, ordered so that the baseline pair (p1, p2) comes first, gives 2n numbers in n pairs: the local
origin o about p1 (angle from the baseline, distance); the baseline's direction in the local frame and its length;
every further landmark about p1 (angle from the baseline, distance). They are the same in every frame, so a local map
measures them (`frame` = identity, local points) and the global map predicts them (`frame` = T_map_local, map points).

All functions broadcast over leading axes. Poses are `[x m, y m, theta rad]`. Source: [Kojima12] eq. 3-5.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ..core.se2 import wrap_angle

Weights = Literal["constant", "paper", "diagonal", "full"]
Frame = Float[np.ndarray, "*b 3"]
Points = Float[np.ndarray, "*b n 2"]

ORIGIN = 0  # pair of rows that holds the local origin; pair 1 holds the baseline itself
BASELINE = 1  # pair of rows that holds the baseline


def predict(frame: Frame, points: Points) -> Float[np.ndarray, "*b m"]:
    """`h(x)`, (..., 2n), angles [rad] in (-pi, pi] at even places, distances [m] at odd ones.

    frame: (..., 3) pose of the local frame in the frame of `points` (..., n >= 2, 2), baseline pair first.
    """
    d = _about_first(frame, points)
    angle = np.arctan2(d[..., 1], d[..., 0])
    y = np.empty_like(d)
    y[..., 0] = angle - angle[..., BASELINE, None]  # [Kojima12] eq. 3
    y[..., BASELINE, 0] = angle[..., BASELINE] - frame[..., 2]  # [Kojima12] eq. 5
    y[..., 0] = wrap_angle(y[..., 0])
    y[..., 1] = np.hypot(d[..., 0], d[..., 1])
    return y.reshape((*y.shape[:-2], 2 * points.shape[-2]))


def measure(points: Points) -> Float[np.ndarray, "*b m"]:
    """`y`, (..., 2n): what a local map measures; points: (..., n, 2) in its own frame, baseline pair first."""
    return predict(np.zeros((*points.shape[:-2], 3)), points)


def residual(y: Float[np.ndarray, "*b m"], h: Float[np.ndarray, "*b m"]) -> Float[np.ndarray, "*b m"]:
    """`y - h` with the angle rows wrapped. # [Kojima12] eq. 9"""
    e = np.asarray(y - h)
    e[..., ::2] = wrap_angle(e[..., ::2])
    return e


def jacobian(frame: Frame, points: Points) -> Float[np.ndarray, "*b m k"]:
    """`dh / d[x, y, theta, p1, p2, .., pn]`, (..., 2n, 3 + 2n)."""
    d = _about_first(frame, points)
    n = points.shape[-2]
    square = np.sum(d * d, axis=-1, keepdims=True)
    g_r = d / np.sqrt(square)  # gradient of |q - p1| by q
    g_a = np.stack([-d[..., 1], d[..., 0]], axis=-1) / square  # gradient of ang(q - p1) by q
    g_b = g_a[..., BASELINE, :]
    H = np.zeros((*d.shape[:-2], n, 2, 3 + 2 * n))
    p1, p2 = slice(3, 5), slice(5, 7)
    H[..., 0, p1] = -g_a + g_b[..., None, :]
    H[..., 0, p2] = -g_b[..., None, :]
    H[..., 1, p1] = -g_r
    H[..., ORIGIN, 0, :2] = g_a[..., ORIGIN, :]
    H[..., ORIGIN, 1, :2] = g_r[..., ORIGIN, :]
    H[..., BASELINE, 0, 2] = -1.0
    H[..., BASELINE, 0, p1] = -g_b
    H[..., BASELINE, 0, p2] = g_b
    H[..., BASELINE, 1, p2] = g_r[..., BASELINE, :]
    own = np.arange(2, n)[:, None]
    columns = 3 + 2 * own + np.arange(2)
    H[..., own, 0, columns] = g_a[..., 2:, :]
    H[..., own, 1, columns] = g_r[..., 2:, :]
    return H.reshape((*d.shape[:-2], 2 * n, 3 + 2 * n))


def noise(
    points: Points,
    cov: Float[np.ndarray, "*b m m"],
    weights: Weights,
    *,
    delta: float = 1.0,
    variance: float = 1e-3,
) -> Float[np.ndarray, "*b m m"]:
    """`R` (..., 2n, 2n) of the relative information of a local map, by error propagation from its covariance.

    points: (..., n, 2) in the local frame, baseline first; cov: (..., 2n, 2n) [m^2] over them. The local origin is
    exact (it is the gauge of the local map), so the pose terms of the paper's sum are zero.
    "constant": `variance` on every row (plain recursive least squares); "paper": the variances of the landmarks
    alone, without their cross terms; "diagonal": the exact variances of the rows; "full": with their correlations,
    which is lossless. Every choice but "constant" is multiplied by `delta`.
    """
    m = 2 * points.shape[-2]
    if weights == "constant":
        return np.broadcast_to(variance * np.eye(m), (*points.shape[:-2], m, m)).copy()
    J = jacobian(np.zeros((*points.shape[:-2], 3)), points)[..., 3:]
    if weights == "full":
        R = J @ cov @ np.swapaxes(J, -1, -2)
        return np.asarray(delta * 0.5 * (R + np.swapaxes(R, -1, -2)))
    if weights == "paper":
        a = np.einsum("...ij,...jj->...i", J * J, cov)  # [Kojima12] eq. 14
    else:
        a = np.einsum("...ij,...jk,...ik->...i", J, cov, J, optimize=True)
    return np.asarray(delta * a[..., None] * np.eye(m))  # [Kojima12] eq. 13


def baseline_pair(
    mean: Float[np.ndarray, "n 2"], cov: Float[np.ndarray, "m m"], among: Int[np.ndarray, " k"] | None = None
) -> tuple[int, int]:
    """The most certain pair: largest `d^2 / (s_i^2 + s_j^2)`, the surer landmark first.

    mean: (n, 2) [m]; cov: (2n, 2n); `among`: the k >= 2 indices to choose from (all when None). A narrow or
    uncertain pair makes every angle uncertain, which diagonal weights do not survive.
    """
    index = np.arange(len(mean)) if among is None else among
    s2 = np.diag(cov).reshape(-1, 2).sum(axis=1)[index]
    d = mean[index, None] - mean[None, index]
    quality = np.sum(d * d, axis=-1) / (s2[:, None] + s2[None])
    np.fill_diagonal(quality, -1.0)
    a, b = np.unravel_index(int(np.argmax(quality)), quality.shape)
    first, second = (a, b) if s2[a] <= s2[b] else (b, a)
    return int(index[first]), int(index[second])


def _about_first(frame: Frame, points: Points) -> Points:
    """Vectors from p1 to (origin, p2, .., pn), (..., n, 2)."""
    q = np.concatenate([frame[..., None, :2], points[..., 1:, :]], axis=-2)
    return np.asarray(q - points[..., :1, :])
