"""What a team with ranging radios knows: how each robot moved, and how far who was from whom.

A node is a pose of a robot or a beacon; a beacon is a pose whose heading means nothing and is held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.records import Track

STANDING = 0.3  # [m] within which a robot stayed that does not tell its heading by ranges


@dataclass(frozen=True, slots=True)
class Motions:
    """m known motions between nodes: `z` (m, 3), pose of `second` in `first`, covariance `cov` (m, 3, 3) of it."""

    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    z: Float[np.ndarray, "m 3"]
    cov: Float[np.ndarray, "m 3 3"]


@dataclass(frozen=True, slots=True)
class Ranges:
    """k ranges between antennas carried by nodes.

    a, b: (k,) nodes; t: (k,) [s]; z: (k,) [m]; sd: (k,) [m], as the log has it, NaN where it does not say; lever_a,
    lever_b: (k, 2) [m] where the antenna was in the node's frame at t: how it is mounted, and how far the robot had
    come from the node's pose.
    """

    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    z: Float[np.ndarray, " k"]
    sd: Float[np.ndarray, " k"]
    lever_a: Float[np.ndarray, "k 2"]
    lever_b: Float[np.ndarray, "k 2"]

    def __len__(self) -> int:
        return len(self.z)

    def select(self, rows: np.ndarray) -> "Ranges":
        return Ranges(*(getattr(self, name)[rows] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class Priors:
    """Nodes known beforehand: `z` (p, 3) with `cov` (p, 3, 3); of a beacon the heading says nothing."""

    node: Int[np.ndarray, " p"]
    z: Float[np.ndarray, "p 3"]
    cov: Float[np.ndarray, "p 3 3"]

    @classmethod
    def none(cls) -> "Priors":
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))


@dataclass(frozen=True, slots=True)
class RangeNetwork:
    """Poses of robots, one robot after the other, each in order of time, then beacons.

    owner: (n,) whose pose a node is, an index into `robots`, or `len(robots) + i` of beacon i; t: (n,) [s], NaN of a
    beacon; names: what a file calls each node.
    """

    robots: tuple[str, ...]
    beacons: tuple[str, ...]
    owner: Int[np.ndarray, " n"]
    t: Float[np.ndarray, " n"]
    motions: Motions
    ranges: Ranges
    priors: Priors = field(default_factory=Priors.none)
    names: tuple[str, ...] = ()
    dropped: Mapping[str, int] = field(default_factory=dict)

    @property
    def everybody(self) -> tuple[str, ...]:
        """Robots, then beacons."""
        return (*self.robots, *self.beacons)

    @property
    def is_beacon(self) -> np.ndarray:
        """Which nodes are beacons, (n,)."""
        return np.asarray(self.owner >= len(self.robots))

    def without(self, motions: Sequence[int]) -> "RangeNetwork":
        """The same without some of its motions."""
        m, keep = self.motions, np.delete(np.arange(len(self.motions.first)), motions)
        return replace(self, motions=Motions(m.first[keep], m.second[keep], m.z[keep], m.cov[keep]))

    def track(self, k: int, pose: Float[np.ndarray, "n 3"], cov: np.ndarray | None = None, frame: str = "map") -> Track:
        """The trajectory of robot k along `pose`, of all nodes, where that is a number; of equal stamps the last."""
        mine = np.flatnonzero((self.owner == k) & np.isfinite(pose[:, 0]))
        mine = mine[np.append(np.diff(self.t[mine]) > 0, np.ones(len(mine[:1]), bool))]
        return Track(self.t[mine], pose[mine], None if cov is None else cov[mine], frame)

    def pairs(self) -> tuple[Int[np.ndarray, "p 2"], Int[np.ndarray, " k"]]:
        """Who ranged to whom (either way is one pair), and which pair each range is of."""
        ends = np.sort(np.stack([self.owner[self.ranges.a], self.owner[self.ranges.b]], axis=1), axis=1)
        pairs, which = np.unique(ends, axis=0, return_inverse=True)
        return pairs.reshape(-1, 2), which.ravel()


@dataclass(frozen=True, slots=True)
class Bodies:
    """What moves as one: poses tied by motions, each body in a frame of its own; each beacon alone.

    of: (n,) which body a node belongs to; pose: (n, 3) in the body's frame; turns: (bodies,) whether ranges can tell
    its heading: not of a beacon, nor of a robot that stands.
    """

    of: Int[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    turns: np.ndarray


def bodies_of(net: RangeNetwork) -> Bodies:
    """The bodies of `net`, their poses added up from motions; nodes with priors are one body, in the priors' frame."""
    n, m = len(net.owner), net.motions
    links = sp.coo_array((np.ones(len(m.first)), (m.first, m.second)), shape=(n, n))
    of = np.asarray(connected_components(links, directed=False)[1], np.int64)
    at: list[list[tuple[int, int]]] = [[] for _ in range(n)]
    for k, (i, j) in enumerate(zip(m.first.tolist(), m.second.tolist(), strict=True)):
        at[i].append((j, k))
        at[j].append((i, -k - 1))
    backward = se2.inverse(m.z)
    pose = np.full((n, 3), np.nan)
    for first in [*net.priors.node.tolist(), *range(n)]:
        if not np.isnan(pose[first, 0]):
            continue
        known = np.flatnonzero(net.priors.node == first)
        pose[first] = net.priors.z[known[0]] if len(known) else 0.0
        reached = [first]
        for i in reached:
            for j, k in at[i]:
                if np.isnan(pose[j, 0]):
                    pose[j] = se2.compose(pose[i], m.z[k] if k >= 0 else backward[-k - 1])
                    reached.append(j)
    if len(net.priors.node):
        of = np.where(np.isin(of, of[net.priors.node]), of[net.priors.node[0]], of)
    of = np.unique(of, return_inverse=True)[1].ravel()
    turns = np.zeros(of.max(initial=-1) + 1, bool)
    for body in np.unique(of[~net.is_beacon]).tolist():
        turns[body] = bool(np.ptp(pose[of == body, :2], axis=0).max() > STANDING)
    return Bodies(of, pose, turns)
