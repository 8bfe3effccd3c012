"""Where a robot's own frame stands in the shared map."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from .columns import listed, triangle
from .messages import Correction

ALONE = (np.zeros(3), np.zeros((3, 3)), 1.0)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a robot's own frame stands in the shared map: `T_map_local`, its covariance, the scale of its lengths.

    own: whether the covariance a robot tells of its pose comes on top; a woven robot's frame has it in already, as it
    counts where the robot is now.
    """

    component: int
    frame: Float[np.ndarray, "3"]
    frame_cov: Float[np.ndarray, "3 3"]
    scale: float
    own: bool = True

    def carry(
        self, pose: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """`T_map_robot` of a `T_local_robot`, and its covariance."""
        shrink = np.diag([1 / self.scale, 1 / self.scale, 1.0])
        small = shrink @ pose
        P = se2.composed_covariance(self.frame, self.frame_cov, small, shrink @ (cov * self.own) @ shrink)
        return se2.compose(self.frame, small), 0.5 * (P + P.T)

    def correction(self, name: str, robot: str) -> Correction:
        """What map process `name` tells `robot`."""
        return Correction(
            map=name, robot=robot, pose=listed(self.frame), cov=triangle(self.frame_cov), scale=self.scale
        )
