"""Relative information: what a landmark map says in no frame at all, as a measurement with its Jacobian and noise.

A map with n landmarks, ordered so that the baseline pair (p1, p2) comes first, gives 2n numbers in n pairs: the local
origin o about p1 (angle from the baseline, distance); the baseline's direction in the local frame and its length;
every further landmark about p1 (angle from the baseline, distance). They are the same in every frame, so a local map
measures them (`frame` = identity, local points) and the global map predicts them (`frame` = T_map_local, map points).

All functions broadcast over leading axes. Poses are `[x m, y m, theta rad]`. Source: [Kojima12] eq. 3-5.
"""

from dataclasses import dataclass
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


Vector = Float[np.ndarray, "*b size"]


@dataclass(frozen=True, slots=True)
class RelativeLayout:
    """The global state `x`: the poses of all frames but the first (the gauge), then all landmarks.

    frames: how many local frames, the gauge counted; landmarks: how many points. Poses are `[x, y, theta]`.
    """

    frames: int
    landmarks: int

    @property
    def size(self) -> int:
        return self.first_landmark + 2 * self.landmarks

    @property
    def first_landmark(self) -> int:
        return 3 * (self.frames - 1)

    @property
    def angles(self) -> Int[np.ndarray, " k"]:
        """The entries of x that are angles."""
        return np.arange(2, self.first_landmark, 3)

    def frame(self, x: Vector, k: int) -> Float[np.ndarray, "*b 3"]:
        """The pose of frame k; the identity for the gauge."""
        return x[..., 3 * (k - 1) : 3 * k] if k else np.zeros((*x.shape[:-1], 3))

    def points(self, x: Vector) -> Float[np.ndarray, "*b n 2"]:
        """All landmarks, (..., landmarks, 2)."""
        return x[..., self.first_landmark :].reshape((*x.shape[:-1], self.landmarks, 2))

    def columns(self, frame: int, landmarks: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
        """The entries of x that a map in `frame` with `landmarks` touches: pose (none for the gauge), then points."""
        pose = np.arange(3 * (frame - 1), 3 * frame) if frame else np.zeros(0, dtype=np.intp)
        points = self.first_landmark + 2 * landmarks[:, None] + np.arange(2)
        return np.concatenate([pose, points.ravel()]).astype(np.intp)

    def pack(self, frames: Float[np.ndarray, "m 3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " size"]:
        """The state from all frames (the gauge's row first and left out) and all landmarks."""
        return np.concatenate([frames[1:].ravel(), points.ravel()])


@dataclass(frozen=True, slots=True)
class Measurement:
    """The relative information of one local map, or of a batch of maps of the same landmarks.

    frame: its frame's place in the layout, 0 the gauge; landmarks: (n,) their places, baseline pair first;
    y: (..., 2n); R: (..., 2n, 2n).
    """

    frame: int
    landmarks: Int[np.ndarray, " n"]
    y: Float[np.ndarray, "*b m"]
    R: Float[np.ndarray, "*b m m"]

    def columns(self, layout: RelativeLayout) -> Int[np.ndarray, " k"]:
        return layout.columns(self.frame, self.landmarks)

    def linearise(
        self, layout: RelativeLayout, x: Vector
    ) -> tuple[Float[np.ndarray, "*b m"], Float[np.ndarray, "*b m k"]]:
        """`e = y - h(x)` and the Jacobian of h by the state's `columns`.

        The paper predicts `H x` (its eq. 8); h is not linear, so h(x) itself is taken.
        """
        frame, points = layout.frame(x, self.frame), layout.points(x)[..., self.landmarks, :]
        h = predict(frame, points)  # [Kojima12] eq. 8
        H = jacobian(frame, points)
        return residual(self.y, h), (H if self.frame else H[..., 3:])

    def dense_jacobian(self, layout: RelativeLayout, x: Vector) -> Float[np.ndarray, "*b m size"]:
        """The Jacobian over the whole state. # [Kojima12] eq. 15"""
        H = np.zeros((*self.y.shape, layout.size))
        H[..., self.columns(layout)] = self.linearise(layout, x)[1]
        return H


def measurement(
    frame: int,
    landmarks: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "*b n 2"],
    cov: Float[np.ndarray, "*b m m"],
    weights: Weights = "full",
    *,
    delta: float = 1.0,
    variance: float = 1e-3,
) -> Measurement:
    """What a local map measures: points (..., n, 2) and cov (..., 2n, 2n) in its own frame, baseline pair first."""
    R = noise(points, cov, weights, delta=delta, variance=variance)
    return Measurement(frame, landmarks, measure(points), R)
