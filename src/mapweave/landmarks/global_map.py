"""The team's map with every robot's submap frame in it, one joint covariance over all."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import frozen
from .landmark_map import LandmarkMap


@dataclass(frozen=True, slots=True)
class GlobalMap:
    """`G = [XL_1 .. XL_M, m_1 .. m_n]`: frames (M, 3) = `T_map_local`, landmarks (n, 2), cov (3M + 2n, 3M + 2n).

    apart: pairs of ids, each sorted, that a robot has told apart and that are therefore never one landmark.
    """

    robots: tuple[str, ...]
    frames: Float[np.ndarray, "r 3"]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    apart: frozenset[tuple[str, str]] = frozenset()

    def __post_init__(self) -> None:
        for name in ("frames", "mean", "cov"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        size = 3 * len(self.robots) + 2 * len(self.ids)
        if self.cov.shape != (size, size):
            msg = (
                f"{len(self.robots)} frames and {len(self.ids)} landmarks do not belong to covariance {self.cov.shape}"
            )
            raise ValueError(msg)

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks alone, frames marginalised away."""
        k = 3 * len(self.robots)
        return LandmarkMap(self.ids, self.mean, self.cov[k:, k:], "map")

    def frame_of(self, robot: str) -> Float[np.ndarray, "3"]:
        return np.asarray(self.frames[self.robots.index(robot)])

    def pose_in_map(self, robot: str, pose_local: Float[np.ndarray, "... 3"]) -> np.ndarray:
        """`T_map_robot` from a pose in the robot's current submap."""
        return se2.compose(self.frame_of(robot), pose_local)


def known_starts(robots: tuple[str, ...], starts: Float[np.ndarray, "r 3"]) -> GlobalMap:
    """No landmark yet; every submap frame at the robot's exactly known start."""
    return GlobalMap(robots, starts, (), np.zeros((0, 2)), np.zeros((3 * len(robots), 3 * len(robots))))
