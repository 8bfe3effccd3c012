"""A landmark map: named points with their joint covariance. What robots hand over and `fuse` takes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import frozen


@dataclass(frozen=True, slots=True)
class LandmarkMap:
    """n landmarks in one frame. mean: (n, 2) [m]; cov: (2n, 2n) [m^2], joint, order x1 y1 x2 y2 ..."""

    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frame: str = "map"

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", frozen(self.mean))
        object.__setattr__(self, "cov", frozen(self.cov))
        if self.cov.shape != (2 * len(self.ids), 2 * len(self.ids)) or len(set(self.ids)) != len(self.ids):
            msg = f"{len(self.ids)} ids (distinct), covariance {self.cov.shape}: they do not belong together"
            raise ValueError(msg)

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, ids: Sequence[str]) -> "LandmarkMap":
        """The marginal over `ids`, in that order."""
        where = {name: i for i, name in enumerate(self.ids)}
        index = np.array([where[name] for name in ids], dtype=np.intp)
        rows = (2 * index[:, None] + np.arange(2)).ravel()
        return LandmarkMap(tuple(ids), self.mean[index], self.cov[np.ix_(rows, rows)], self.frame)

    def moved(self, T_new_old: Float[np.ndarray, "3"], frame: str) -> "LandmarkMap":
        """The same map expressed in `frame` through an exactly known transform."""
        C = np.kron(np.eye(len(self)), se2.rotation(float(T_new_old[2])))
        return LandmarkMap(self.ids, se2.act(T_new_old, self.mean), C @ self.cov @ C.T, frame)
