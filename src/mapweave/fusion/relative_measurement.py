"""Local maps as measurements of one global state: where their parts stand in it, and how they are linearised."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from . import relative_information
from .relative_information import Weights

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
        h = relative_information.predict(frame, points)  # [Kojima12] eq. 8
        H = relative_information.jacobian(frame, points)
        return relative_information.residual(self.y, h), (H if self.frame else H[..., 3:])

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
    R = relative_information.noise(points, cov, weights, delta=delta, variance=variance)
    return Measurement(frame, landmarks, relative_information.measure(points), R)
