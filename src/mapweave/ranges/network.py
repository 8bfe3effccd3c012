"""What a team with ranging radios knows: how each robot moved, and how far who was from whom.

A node is a pose of a robot or a beacon; a beacon is a pose whose heading means nothing and is held. Of a log they are
poses at instants, with ranges between them reached along the odometry.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.findings import Finding, Unused
from ..core.fixes import Fixes
from ..core.names import in_order
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
    come from the node's pose; rate_a, rate_b: (k, 2) [m/s] how these moved then; s: (k,) when it was, from -1/2 to 1/2.
    """

    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    z: Float[np.ndarray, " k"]
    sd: Float[np.ndarray, " k"]
    lever_a: Float[np.ndarray, "k 2"]
    lever_b: Float[np.ndarray, "k 2"]
    rate_a: Float[np.ndarray, "k 2"]
    rate_b: Float[np.ndarray, "k 2"]
    s: Float[np.ndarray, " k"]

    def __len__(self) -> int:
        return len(self.z)

    def select(self, rows: np.ndarray) -> "Ranges":
        return Ranges(*(getattr(self, name)[rows] for name in self.__slots__))

    @classmethod
    def of_points(
        cls, a: Int[np.ndarray, " k"], b: Int[np.ndarray, " k"], t: np.ndarray, z: np.ndarray, sd: np.ndarray
    ) -> "Ranges":
        """Ranges between the nodes themselves, as those of graphs are."""
        none = np.zeros((len(z), 2))
        return cls(a, b, t, z, sd, none, none, none, none, through(t))

    def late(self, a: Float[np.ndarray, " k"], b: Float[np.ndarray, " k"]) -> "Ranges":
        """The same, where their stamps are so much [s] later than those of odometry of either end."""
        shifted = (self.lever_a - a[:, None] * self.rate_a, self.lever_b - b[:, None] * self.rate_b)
        return replace(self, lever_a=shifted[0], lever_b=shifted[1])


def through(t: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Stamps as they go from -1/2 to 1/2 over a log."""
    first, last = (float(t.min()), float(t.max())) if len(t) else (0.0, 0.0)
    return np.asarray((t - 0.5 * (first + last)) / max(last - first, 1e-9))


class StampShift(NamedTuple):
    """By how much [s] stamps of ranges are later than those of a robot's odometry amid a log, and more at its end than
    at its beginning.
    """

    lag: float = 0.0
    drift: float = 0.0

    def plus(self, more: "StampShift") -> "StampShift":
        return StampShift(self.lag + more.lag, self.drift + more.drift)


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


PIECE = 10.0  # [m] of way that a piece has at least: odometry drifts less on shorter ones than their places are open


def in_pieces(bodies: Bodies, pieces: int) -> tuple[Bodies, Int[np.ndarray, " m"]]:
    """`bodies` of which each that moves is cut into up to `pieces` of equal way, and of which body each piece is.

    Poses stay in the frames of the bodies: a piece laid where the one before it lies goes on as its odometry does.
    """
    place = np.zeros(len(bodies.of), np.int64)
    for body in np.flatnonzero(bodies.turns).tolist():
        rows = np.flatnonzero(bodies.of == body)
        way = np.append(0.0, np.cumsum(np.hypot(*np.diff(bodies.pose[rows, :2], axis=0).T)))
        n = max(1, min(pieces, int(way[-1] / PIECE)))
        place[rows] = np.minimum(n * way / way[-1], n - 1).astype(np.int64)
    keys, of = np.unique(np.column_stack([bodies.of, place]), axis=0, return_inverse=True)
    of = of.ravel()
    turns = np.zeros(len(keys), bool)
    for piece in np.flatnonzero(bodies.turns[keys[:, 0]]).tolist():
        turns[piece] = bool(np.ptp(bodies.pose[of == piece, :2], axis=0).max() > STANDING)
    return Bodies(of, bodies.pose, turns), keys[:, 0]


STEP = 0.25  # [s] between two poses that are estimated, at least; between, odometry carries a range's ends
BEYOND = 0.3  # [s] before the first odometry or after the last in which a robot is taken to be where that is
SILENT = 2.0  # [s] without odometry, and that many times its usual interval, from which it does not tell the way
# What odometry errs by: along and across over the way [m/sqrt(m)], the heading over the way [rad/sqrt(m)] and over the
# turn [rad/sqrt(rad)], and what a standing robot may have been pushed about [m/sqrt(s)], [rad/sqrt(s)].
ALONG, ACROSS, DRIFT, TURN, REST_XY, REST_THETA = 0.03, 0.015, 0.03, 0.04, 1e-3, 1e-3


NO_NUMBER = "range that is no positive number"  # why it is left out


@dataclass(frozen=True, slots=True)
class RangeLog:
    """odometry: robot -> its track in a frame of its own; a, b: (k,) who ranged to whom, into `names`, robots first;

    t: (k,) [s]; z: (k,) [m]; antennas: name -> where its antenna stands on the robot [m, m]; known: beacons whose
    place is known, with their sd [m]; fixes: of robots; dropped: reason -> rows; others: those of `names` that are
    robots too, and no beacons, whose odometry is elsewhere.
    """

    odometry: Mapping[str, Track]
    names: tuple[str, ...]
    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    z: Float[np.ndarray, " k"]
    antennas: Mapping[str, Float[np.ndarray, "2"]] = field(default_factory=dict)
    known: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    fixes: Mapping[str, Fixes] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)
    source: str = ""
    log_hash: str = ""
    unused: tuple[Unused, ...] = ()
    findings: tuple[Finding, ...] = ()
    others: tuple[str, ...] = ()

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp [s] of odometry."""
        return min(float(k.t[0]) for k in self.odometry.values()), max(float(k.t[-1]) for k in self.odometry.values())

    def until(self, t: float) -> "RangeLog":
        """What was recorded by `t` [s]: of robots whose odometry had begun, and among these alone."""
        begun = {name: int(np.searchsorted(k.t, t, side="right")) for name, k in self.odometry.items()}
        odometry = {
            name: replace(k, t=k.t[:n], pose=k.pose[:n])
            for (name, k), n in zip(self.odometry.items(), begun.values(), strict=True)
            if n
        }
        gone = [k for k, name in enumerate(self.names) if begun.get(name, 1) == 0]
        rows = (self.t <= t) & ~np.isin(self.a, gone) & ~np.isin(self.b, gone)
        return replace(
            self,
            odometry=odometry,
            a=self.a[rows],
            b=self.b[rows],
            t=self.t[rows],
            z=self.z[rows],
            fixes={name: fixes.within(-np.inf, t) for name, fixes in self.fixes.items() if name in odometry},
        )


def network_of(log: RangeLog, clocks: Mapping[str, StampShift] | None = None) -> RangeNetwork:
    """The network of `log`: ranges that cannot be are left out and counted, beacons nobody ranged to are not there.

    clocks: of robots whose odometry is known to be on another clock than ranges.
    """
    robots = tuple(sorted(log.odometry, key=in_order))
    kept, dropped = _kept(log, robots)
    used = {log.names[k] for k in np.unique(np.concatenate([log.a[kept], log.b[kept]])).tolist()} - set(robots)
    beacons = tuple(sorted(used, key=in_order))
    instants = [_instants(log.odometry[name].t) for name in robots]
    starts = np.concatenate([[0], np.cumsum([len(i) for i in instants])]).astype(int)
    tracks = [log.odometry[name] for name in robots]
    parts = [steps(track.pose[i], track.t[i]) for track, i in zip(tracks, instants, strict=True)]
    z, var = (np.concatenate(each) for each in zip(*parts, strict=True))
    first = np.delete(np.arange(starts[-1]), starts[1:] - 1)
    motions = Motions(first, first + 1, z, var[:, :, None] * np.eye(3))
    n = int(starts[-1])
    owner = np.concatenate(
        [*(np.full(len(i), k) for k, i in enumerate(instants)), len(robots) + np.arange(len(beacons))]
    )
    t = np.concatenate(
        [*(track.t[i] for track, i in zip(tracks, instants, strict=True)), np.full(len(beacons), np.nan)]
    )
    ends, s = [], through(log.t[kept])
    for which in (log.a[kept], log.b[kept]):
        node, lever, rate = np.zeros(len(which), np.int64), np.zeros((len(which), 2)), np.zeros((len(which), 2))
        for k in np.unique(which).tolist():
            mine, name = which == k, log.names[k]
            if name in beacons:
                node[mine] = n + beacons.index(name)
                continue
            r = robots.index(name)
            track, at = tracks[r], instants[r]
            lag, drift = (clocks or {}).get(name, StampShift())
            stamp = log.t[kept][mine] - lag - drift * s[mine]
            nearest = np.clip(np.searchsorted(track.t[at], stamp, side="right") - 1, 0, len(at) - 1)
            around = (np.clip(stamp + dt, track.t[0], track.t[-1]) for dt in (0.0, -0.5 * STEP, 0.5 * STEP))
            from_node = [se2.between(track.pose[at][nearest], se2.interpolate(k, track.t, track.pose)) for k in around]
            there, before, after = (se2.act(T, log.antennas.get(name, np.zeros(2))) for T in from_node)
            node[mine], lever[mine], rate[mine] = starts[r] + nearest, there, (after - before) / STEP
        ends.append((node, lever, rate))
    (a, lever_a, rate_a), (b, lever_b, rate_b) = ends
    untold = np.full(len(kept), np.nan)
    ranges = Ranges(a, b, log.t[kept], log.z[kept], untold, lever_a, lever_b, rate_a, rate_b, s)
    known = [(n + k, *log.known[name]) for k, name in enumerate(beacons) if name in log.known]
    priors = Priors(
        np.array([p[0] for p in known], np.int64),
        np.array([(p[1], p[2], 0.0) for p in known]).reshape(-1, 3),
        np.array([np.diag([p[3] ** 2, p[3] ** 2, 1.0]) for p in known]).reshape(-1, 3, 3),
    )
    return RangeNetwork(robots, beacons, owner, t, motions, ranges, priors, dropped=dropped)


def _kept(log: RangeLog, robots: tuple[str, ...]) -> tuple[Int[np.ndarray, " m"], dict[str, int]]:
    """Which ranges can be used, in order of time, and how many could not, by reason."""
    dropped = dict(log.dropped)
    elsewhere = [k for k, name in enumerate(log.names) if name in log.others and name not in robots]
    keep = np.ones(len(log.z), bool)
    outside = np.zeros(len(log.z), bool)
    for end in (log.a, log.b):
        for k in np.unique(end).tolist():
            if log.names[k] in robots:
                t = log.odometry[log.names[k]].t
                gaps = [(-np.inf, t[0]), (t[-1], np.inf), *silences(t)]
                during = [(log.t > first + BEYOND) & (log.t < last - BEYOND) for first, last in gaps]
                outside |= (end == k) & np.any(during, axis=0)
    for reason, bad in (
        ("range to itself", log.a == log.b),
        (NO_NUMBER, ~(np.isfinite(log.z) & (log.z > 0))),
        ("range to a robot that told no odometry", np.isin(log.a, elsewhere) | np.isin(log.b, elsewhere)),
        ("range while odometry is silent", outside),
    ):
        wrong = bad & keep
        keep &= ~bad
        if wrong.any():
            dropped[reason] = dropped.get(reason, 0) + int(wrong.sum())
    rows = np.flatnonzero(keep)
    place = {name: k for k, name in enumerate(sorted(log.names, key=in_order))}
    a, b = (np.array([place[log.names[k]] for k in end[rows].tolist()], np.int64) for end in (log.a, log.b))
    in_time = np.lexsort((log.z[rows], b, a, log.t[rows]))  # the same in whatever order they came
    return rows[in_time], dict(sorted(dropped.items()))


def silences(t: Float[np.ndarray, " n"]) -> list[tuple[float, float]]:
    """From when to when [s] odometry of these stamps was silent."""
    dt = np.diff(t)
    long = np.flatnonzero(dt > SILENT * max(1.0, float(np.median(dt)) if len(dt) else 1.0)).tolist()
    return [(float(t[k]), float(t[k + 1])) for k in long]


def _instants(t: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Which stamps get a pose: the first, each that comes `STEP` after the one before, the last."""
    at = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], STEP)))
    return np.unique(np.append(at, len(t) - 1))


def steps(
    pose: Float[np.ndarray, "k 3"], t: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """From each pose to the next, what odometry says, and the variances by which it may be off."""
    z = np.asarray(se2.between(pose[:-1], pose[1:]))
    way, turn, dt = np.hypot(z[:, 0], z[:, 1]), np.abs(z[:, 2]), np.diff(t)
    xy, theta = REST_XY**2 * dt + 1e-8, TURN**2 * turn + REST_THETA**2 * dt + 1e-8
    gone = np.isin(t[:-1], [first for first, _ in silences(t)])
    if gone.any() and not gone.all():  # it may have driven as it did before and after, and turned anywhere
        speed = float(way[~gone].sum() / dt[~gone].sum())
        xy, theta = np.where(gone, np.square(speed * dt), xy), np.where(gone, np.pi**2, theta)
    return z, np.column_stack([ALONG**2 * way + xy, ACROSS**2 * way + xy, DRIFT**2 * way + theta])
