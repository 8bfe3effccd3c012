"""Poses and what is known between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.arrays import frozen


@dataclass(frozen=True, slots=True)
class PoseGraph:
    """n poses and m edges.

    pose: (n, 3) in `map`; first, second: (m,), indices into `pose`; measured: (m, 3), pose of `second` in `first`;
    information: (m, 3, 3) over x, y, theta [1/m^2, 1/rad^2], symmetric.
    """

    pose: Float[np.ndarray, "n 3"]
    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    measured: Float[np.ndarray, "m 3"]
    information: Float[np.ndarray, "m 3 3"]

    def __post_init__(self) -> None:
        for name in ("pose", "measured", "information"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("first", "second"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int64))

    def __len__(self) -> int:
        return len(self.pose)
