"""A swarm that sees itself: who saw whom in which direction, and what is known beforehand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import DataError
from ..core.names import in_order
from ..core.records import frozen

DEFAULT_SIGMA = float(np.radians(1.0))  # [rad]; standard deviation of a bearing where none is said


class Distance(NamedTuple):
    """Robots i and j (indices) are `metres` apart, exactly when `sigma` [m] is 0."""

    i: int
    j: int
    metres: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Network:
    """n robots and m sightings, robots named by their index into `ids`.

    observer, target: (m,); bearing: (m,) [rad] counter-clockwise from the common axis in 2D (from the observer's own
    heading when `axis` is False), (m, 3) unit vectors in 3D; sigma: (m,) [rad] per sighting (in 3D of each tangent
    direction), all zero for exact sightings; anchors: known positions [m] by index; distances: known ones.
    Raises DataError when the parts do not belong together.
    """

    ids: tuple[str, ...]
    dim: int
    observer: Int[np.ndarray, " m"]
    target: Int[np.ndarray, " m"]
    bearing: Float[np.ndarray, "m *k"]
    sigma: Float[np.ndarray, " m"]
    anchors: Mapping[int, Float[np.ndarray, " d"]] = field(default_factory=dict)
    distances: tuple[Distance, ...] = ()
    axis: bool = True

    def __post_init__(self) -> None:
        for name, kind in (("observer", np.intp), ("target", np.intp), ("bearing", float), ("sigma", float)):
            object.__setattr__(self, name, frozen(getattr(self, name), kind))
        known = {int(k): frozen(np.asarray(v, float).copy()) for k, v in self.anchors.items()}
        object.__setattr__(self, "anchors", known)
        object.__setattr__(self, "distances", tuple(Distance(*d) for d in self.distances))
        problem = self._problem()
        if problem:
            raise DataError(problem)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def direction(self) -> Float[np.ndarray, "m d"]:
        """Sightings as unit vectors, in the common axes (the observer's own when `axis` is False)."""
        if self.dim == 3:
            return self.bearing
        return np.stack([np.cos(self.bearing), np.sin(self.bearing)], axis=1)

    @property
    def is_anchor(self) -> np.ndarray:
        """(n,) bool."""
        known = np.zeros(len(self), dtype=bool)
        known[list(self.anchors)] = True
        return known

    def select(self, rows: np.ndarray) -> "Network":
        """The same robots with only the sightings `rows` (indices or mask)."""
        return Network(
            self.ids,
            self.dim,
            self.observer[rows],
            self.target[rows],
            self.bearing[rows],
            self.sigma[rows],
            self.anchors,
            self.distances,
            self.axis,
        )

    def _problem(self) -> str:
        n, m = len(self.ids), len(self.observer)
        ends = np.concatenate([self.observer, self.target])
        shape = (m,) if self.dim == 2 else (m, 3)
        checks = (
            (self.dim not in {2, 3}, f"dimension {self.dim}: expected 2 or 3"),
            (len(set(self.ids)) != n, "robot ids are not distinct"),
            (self.bearing.shape != shape, f"bearings of shape {self.bearing.shape} for {m} sightings in {self.dim}D"),
            (self.dim == 3 and not self.axis, "3D needs a common axis"),
            (bool(np.any((ends < 0) | (ends >= n))), "a sighting names a robot that is not in the network"),
            (bool(np.any(self.observer == self.target)), "a robot sights itself"),
            (not np.isfinite(self.bearing).all(), "bearings must be finite"),
            (
                not (np.isfinite(self.sigma) & (self.sigma >= 0)).all(),
                "standard deviations must be finite, not negative",
            ),
            (bool(np.any(self.sigma == 0) and np.any(self.sigma > 0)), "standard deviations are zero for some only"),
        )
        problems = [message for bad, message in checks if bad]
        problems += [
            f"anchor {self.ids[k] if 0 <= k < n else k}: expected {self.dim} finite coordinates, found {p}"
            for k, p in self.anchors.items()
            if not 0 <= k < n or p.shape != (self.dim,) or not np.isfinite(p).all()
        ]
        problems += [
            f"distance {d.i},{d.j} = {d.metres}: expected two robots and a positive number"
            for d in self.distances
            if not (0 <= d.i < n and 0 <= d.j < n) or d.i == d.j or not d.metres > 0
        ]
        return problems[0] if problems else ""


def network(
    dim: int,
    observer: Sequence[str],
    target: Sequence[str],
    bearing: np.ndarray,
    sigma: np.ndarray | float = DEFAULT_SIGMA,
    anchors: Mapping[str, Sequence[float] | np.ndarray] | None = None,
    distances: Sequence[tuple[str, str, float]] = (),
    *,
    axis: bool = True,
) -> Network:
    """A `Network` from names; ids in natural order (2 before 10). Raises DataError on an unknown anchor."""
    ids = tuple(sorted(set(observer) | set(target), key=in_order))
    index = {name: i for i, name in enumerate(ids)}
    known = anchors or {}
    for name in [*known, *(name for d in distances for name in d[:2])]:
        if name not in index:
            raise DataError(f"robot {name!r} is given but no sighting names it")
    m = len(observer)
    return Network(
        ids,
        dim,
        np.array([index[name] for name in observer], dtype=np.intp),
        np.array([index[name] for name in target], dtype=np.intp),
        np.asarray(bearing, float).reshape((m,) if dim == 2 else (m, 3)),
        np.broadcast_to(np.asarray(sigma, float), (m,)),
        {index[name]: np.asarray(p, float) for name, p in known.items()},
        tuple(Distance(index[i], index[j], float(d)) for i, j, d in distances),
        axis,
    )
