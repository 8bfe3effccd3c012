"""What is known to be true, for scoring alone: surveyed landmarks, and relations between poses."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .records import freeze


@dataclass(frozen=True, slots=True)
class Survey:
    """n surveyed landmarks. xy: (n, 2) [m] in the survey's own frame."""

    ids: tuple[str, ...]
    xy: Float[np.ndarray, "n 2"]

    def __post_init__(self) -> None:
        freeze(self, "xy")

    def __len__(self) -> int:
        return len(self.ids)


NO_SURVEY = Survey((), np.zeros((0, 2)))


@dataclass(frozen=True, slots=True)
class Relations:
    """n relations: at `t2` (n,) [s] the robot was at `pose` (n, 3) in the frame of the robot at `t1` (n,)."""

    t1: Float[np.ndarray, " n"]
    t2: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    source: str = ""

    def __post_init__(self) -> None:
        freeze(self, "t1", "t2", "pose")

    def __len__(self) -> int:
        return len(self.t1)

    def select(self, keep: np.ndarray) -> "Relations":
        return Relations(self.t1[keep], self.t2[keep], self.pose[keep], self.source)
