"""Poses and what is known between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.records import frozen


@dataclass(frozen=True, slots=True)
class PoseGraph:
    """n poses and m edges.

    pose: (n, 3) in `map`; first, second: (m,), indices into `pose`; measured: (m, 3), pose of `second` in `first`;
    information: (m, 3, 3) in second's frame over x, y, theta [1/m^2, 1/rad^2], symmetric.
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

    @classmethod
    def of(
        cls,
        pose: Float[np.ndarray, "n 3"],
        pairs: Sequence[tuple[int, int]],
        measured: Sequence[np.ndarray],
        information: Sequence[np.ndarray],
    ) -> "PoseGraph":
        """The graph of an edge for each of `pairs`, there may be none."""
        ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        relative = np.array(measured, dtype=float).reshape(-1, 3)
        return cls(pose, ends[:, 0], ends[:, 1], relative, np.array(information, dtype=float).reshape(-1, 3, 3))

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def edges(self) -> int:
        """How many edges there are."""
        return len(self.first)

    def joined(self, other: "PoseGraph") -> "PoseGraph":
        """These poses with these edges and then those of `other`, which is over the same poses."""
        names = ("first", "second", "measured", "information")
        return PoseGraph(self.pose, *(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))
