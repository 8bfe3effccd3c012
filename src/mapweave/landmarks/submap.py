"""A local map with the robot in it: what an EKF-SLAM run or a submap of exploration ends with."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.records import frozen
from .landmark_map import LandmarkMap


@dataclass(frozen=True, slots=True)
class Submap:
    """Robot pose and n landmarks in `frame` (`local_k`: the first pose). cov: (3 + 2n, 3 + 2n), pose first."""

    robot: str
    pose: Float[np.ndarray, "3"]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frame: str

    def __post_init__(self) -> None:
        for name in ("pose", "mean", "cov"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        size = 3 + 2 * len(self.ids)
        if self.cov.shape != (size, size) or self.mean.shape != (len(self.ids), 2):
            msg = f"{len(self.ids)} ids do not belong to mean {self.mean.shape} and covariance {self.cov.shape}"
            raise ValueError(msg)

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks alone, the pose marginalised away."""
        return LandmarkMap(self.ids, self.mean, self.cov[3:, 3:], self.frame)
