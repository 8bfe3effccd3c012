"""Which robot needs a state at which instant: one knot for every stamp a robot has a part in."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.bearings import BearingTable


@dataclass(frozen=True, slots=True)
class Timeline:
    """K knots, those of one robot together and ascending in time.

    robot: (K,) index; t: (K,) [s]; observer, target: (m,) the knots that each sighting ties.
    """

    robot: Int[np.ndarray, " K"]
    t: Float[np.ndarray, " K"]
    observer: Int[np.ndarray, " m"]
    target: Int[np.ndarray, " m"]

    def __len__(self) -> int:
        return len(self.robot)

    @property
    def moves(self) -> Int[np.ndarray, "s 2"]:
        """Consecutive knots of one robot."""
        k = np.flatnonzero(self.robot[1:] == self.robot[:-1])
        return np.column_stack([k, k + 1])

    @property
    def first(self) -> Bool[np.ndarray, " K"]:
        """Whether a knot is its robot's first."""
        out = np.ones(len(self), dtype=bool)
        out[1:] = self.robot[1:] != self.robot[:-1]
        return out

    def of(self, robot: int) -> slice:
        low, high = np.searchsorted(self.robot, [robot, robot + 1])
        return slice(int(low), int(high))


def timeline(table: BearingTable, still: AbstractSet[int], merge: float) -> Timeline:
    """The knots of a stamped `table`; robots that stand `still` have one, stamps closer than `merge` [s] are one."""
    assert table.t is not None  # noqa: S101  (callers hand in stamped tables)
    robot = np.concatenate([table.observer, table.target])
    t = np.concatenate([table.t, table.t])
    if still:
        t = np.where(np.isin(robot, list(still)), t.min(), t)
    order = np.lexsort((t, robot))
    r, s = robot[order], t[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (r[1:] != r[:-1]) | (s[1:] - s[:-1] > merge)
    knot = np.empty(len(order), dtype=np.int64)
    knot[order] = np.cumsum(new) - 1
    m = len(table.observer)
    return Timeline(r[new], s[new], knot[:m], knot[m:])
