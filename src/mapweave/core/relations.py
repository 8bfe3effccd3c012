"""Relations between poses: what somebody measured by hand or matched and checked, as a truth to score against."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .arrays import frozen


@dataclass(frozen=True, slots=True)
class Relations:
    """n relations: at `t2` (n,) [s] the robot was at `pose` (n, 3) in the frame of the robot at `t1` (n,)."""

    t1: Float[np.ndarray, " n"]
    t2: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("t1", "t2", "pose"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.t1)

    def select(self, keep: np.ndarray) -> "Relations":
        return Relations(self.t1[keep], self.t2[keep], self.pose[keep], self.source)
