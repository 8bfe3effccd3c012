"""Where a robot was in places that its map knows well: poses that hang on keyframes and are none themselves."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.records import frozen


@dataclass(frozen=True, slots=True)
class Revisits:
    """v poses in the order of their stamps t (v,) [s].

    at: (v,) the keyframe each hangs on; step: (v, 3) its pose in that keyframe's frame; cov: (v, 3, 3) of the step over
    x, y, theta of the pose's own frame. closures: how many were given up with the keyframes that stood there.
    """

    t: Float[np.ndarray, " v"] = field(default_factory=lambda: np.zeros(0))
    at: Int[np.ndarray, " v"] = field(default_factory=lambda: np.zeros(0, np.int64))
    step: Float[np.ndarray, "v 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    cov: Float[np.ndarray, "v 3 3"] = field(default_factory=lambda: np.zeros((0, 3, 3)))
    closures: int = 0

    def __post_init__(self) -> None:
        for name in ("t", "step", "cov"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "at", frozen(self.at, np.int64))

    def __len__(self) -> int:
        return len(self.t)

    def poses(self, keyframes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "v 3"]:
        """Where they are when the keyframes stand at these poses."""
        return np.asarray(se2.compose(keyframes[self.at], self.step))

    def covariances(
        self, keyframes: Float[np.ndarray, "n 3"], cov: Float[np.ndarray, "n 3 3"]
    ) -> Float[np.ndarray, "v 3 3"]:
        """Of the poses, over x, y, theta in the keyframes' frame: what the keyframe errs, its heading times the way
        to the pose with it, and what the step errs.
        """
        pose, base = self.poses(keyframes), keyframes[self.at]
        J = np.tile(np.eye(3), (len(self), 1, 1))
        J[:, 0, 2], J[:, 1, 2] = base[:, 1] - pose[:, 1], pose[:, 0] - base[:, 0]
        return np.asarray(J @ cov[self.at] @ J.swapaxes(1, 2) + se2.turned_covariance(pose[:, 2], self.cov))
