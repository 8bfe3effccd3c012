"""A swarm that sees itself: who saw whom in which direction, which robots are connected, what contradicts others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from ..core.bearings import BearingTable
from ..core.errors import DataError
from ..core.names import in_order
from ..core.records import frozen

CONSISTENCY_GATE = float(6.0 * np.sqrt(2.0))  # standard deviations by which two sightings of one pair may differ
CONSISTENCY_ROUNDED = 4.0  # times as often as rounding explains, equal readings without stamps are copies
CONSISTENCY_LEAST_PAIRS = 5  # mutual pairs below which nothing is said about axes
AXIS_ANGLE = 0.5  # [rad] median miss of mutual sightings up to which axes count as common, or
AXIS_SIGMAS = 20.0  # standard deviations of it

READINGS = 200  # of one pair that are compared with each other: 19,900 pairs
DEFAULT_SIGMA = float(np.radians(1.0))  # [rad]; standard deviation of a bearing where none is said


class Distance(NamedTuple):
    """Robots i and j (indices) are `metres` apart, exactly when `sigma` [m] is 0."""

    i: int
    j: int
    metres: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class BearingNetwork:
    """n robots and m sightings, robots named by their index into `ids`.

    observer, target: (m,); bearing: (m,) [rad] counter-clockwise from the common axis in 2D (in the
    observer's own axes when `axis` is False), (m, 3) unit vectors in 3D; sigma: (m,) [rad] per sighting (in 3D of each
    tangent direction), all zero for exact sightings; anchors: known positions [m] by index; distances: known ones.
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

    def select(self, rows: np.ndarray) -> "BearingNetwork":
        """The same robots with only the sightings `rows` (indices or mask)."""
        return BearingNetwork(
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
) -> BearingNetwork:
    """A `BearingNetwork` from names; ids in natural order (2 before 10). Raises DataError on an unknown anchor."""
    ids = tuple(sorted(set(observer) | set(target), key=in_order))
    index = {name: i for i, name in enumerate(ids)}
    known = anchors or {}
    for name in [*known, *(name for d in distances for name in d[:2])]:
        if name not in index:
            raise DataError(f"robot {name!r} is given but no sighting names it")
    m = len(observer)
    return BearingNetwork(
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


EXACT_DISTANCE = 1e-4  # an exact distance is held to this many bearing standard deviations of itself


@dataclass(frozen=True, slots=True)
class Components:
    """label: (n,) connected component of each robot; known: (c,) anchors at distinct places; reference: reported."""

    label: Int[np.ndarray, " n"]
    known: Int[np.ndarray, " c"]
    measured: np.ndarray  # (c,) bool: a distance is known in it
    reference: int

    @property
    def anchored(self) -> bool:
        """Whether anchors give place and scale somewhere, so that there is no gauge to choose."""
        return bool((self.known >= 2).any() or ((self.known == 1) & self.measured).any())

    def fixed(self, c: int) -> bool:
        """Whether component `c` has place and scale from anchors and distances."""
        return bool(self.known[c] >= 2 or (self.known[c] == 1 and self.measured[c]))


def components(net: BearingNetwork) -> Components:
    """The components of the network; the reference has sightings, most anchors (2 count as many), and is largest."""
    n = len(net)
    i = np.concatenate([net.observer, np.array([d.i for d in net.distances], dtype=np.intp)])
    j = np.concatenate([net.target, np.array([d.j for d in net.distances], dtype=np.intp)])
    count, label = connected_components(sp.csr_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    known, measured = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
    for c in range(count) if net.anchors else ():
        places = {tuple(p) for k, p in net.anchors.items() if label[k] == c}
        known[c] = len(places)
    for d in net.distances:
        measured[label[d.i]] = True
    size = np.bincount(label, minlength=count)
    worth = np.minimum(known + (measured & (known > 0)), 2)
    seen = np.bincount(label[net.observer], minlength=count) > 0
    reference = int(np.lexsort((size, worth, seen))[-1]) if count else 0
    return Components(label, known, measured, reference)


def effective_sigma(net: BearingNetwork) -> Float[np.ndarray, " m"]:
    """Standard deviations to weigh by: exact sightings (all zero) weigh alike, as with R = I."""
    return net.sigma if np.any(net.sigma > 0) else np.ones(len(net.sigma))


def contradictions(table: BearingTable, sigma: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Which rows contradict another of the same observer, target and stamp.

    Of two that contradict, both; of three or more, those far from the median direction of all. sigma: (m,) [rad].
    """
    n = len(table.ids)
    key = table.observer * n + table.target
    stamp = np.zeros(len(key)) if table.t is None else table.t
    order = np.lexsort((stamp, key))
    same = (key[order][1:] == key[order][:-1]) & (stamp[order][1:] == stamp[order][:-1])
    bad = np.zeros(len(key), dtype=bool)
    if not same.any():
        return bad
    edges = np.flatnonzero(np.concatenate([[True], ~same, [True]]))
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if high - low < 2:
            continue
        rows = order[low:high]
        u = table.direction[rows]
        if high - low == 2:
            off = np.full(2, _angle(u[:1], u[1:])[0])
        else:
            middle = np.median(u, axis=0)
            off = _angle(u, middle[None, :])
        bad[rows] = off > CONSISTENCY_GATE * sigma[rows]
        if high - low == 2:
            bad[rows] = bad[rows].any()
    return bad


def copies(table: BearingTable, sigma: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Which rows repeat an earlier one to the bit: observer, target, direction, sigma (m,) [rad] and stamp.

    Without stamps readings of one pair may be equal because they were rounded. Then the step they were rounded to shows
    in the smallest difference between two of them, and equal ones are copies only where they are more often equal than
    `cfg.rounded` times what that step and sigma explain; where no two differ, nothing tells of noise anew.
    """
    n, m = len(table.ids), len(table.observer)
    columns = [table.observer[:, None], table.target[:, None], table.direction, sigma[:, None]]
    if table.t is not None:
        columns.append(table.t[:, None])
    rows = np.ascontiguousarray(np.hstack(columns).astype(float) + 0.0)
    _, first = np.unique(rows.view([("", rows.dtype)] * rows.shape[1]).ravel(), return_index=True)
    again = np.ones(m, dtype=bool)
    again[first] = False
    if table.t is not None or not again.any():
        return again
    step, pairs, equal = np.inf, 0, 0
    key = table.observer * n + table.target
    order = np.argsort(key, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        i, j = np.triu_indices(min(len(group), READINGS), 1)
        off = _angle(table.direction[group[i]], table.direction[group[j]])
        same = (rows[group[i]] == rows[group[j]]).all(axis=1)
        pairs, equal = pairs + len(off), equal + int(np.count_nonzero(same))
        step = min(step, float(off[~same].min(initial=np.inf)))
    chance = min(step / (2.0 * np.sqrt(np.pi) * max(float(np.median(sigma)), 1e-12)), 1.0) if np.isfinite(step) else 0.0
    return again if equal > CONSISTENCY_ROUNDED * chance * pairs else np.zeros(m, dtype=bool)


def shares_an_axis(table: BearingTable, sigma: Float[np.ndarray, " m"]) -> bool:
    """False when mutual sightings plainly do not point at each other: every robot has axes of its own."""
    n = len(table.ids)
    forth, back = table.observer * n + table.target, table.target * n + table.observer
    _, a, b = np.intersect1d(forth, back, return_indices=True)
    mutual = table.observer[a] < table.target[a]
    a, b = a[mutual], b[mutual]
    if len(a) < CONSISTENCY_LEAST_PAIRS:
        return True
    off = _angle(table.direction[a], -table.direction[b])
    return bool(np.median(off) <= max(AXIS_ANGLE, AXIS_SIGMAS * float(np.median(sigma))))


def _angle(a: Float[np.ndarray, "k d"], b: Float[np.ndarray, "l d"]) -> Float[np.ndarray, " k"]:
    """Angles [rad] between rows; b need not be of unit length."""
    dot = np.sum(a * b, axis=1)
    across = np.sqrt(np.maximum(np.sum(a * a, axis=1) * np.sum(b * b, axis=1) - dot * dot, 0.0))
    return np.asarray(np.arctan2(across, dot))
