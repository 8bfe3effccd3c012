"""A log of ranges and odometry becomes a network: poses at instants, ranges between them reached along the odometry."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.findings import Finding, Unused
from ..core.fixes import Fixes
from ..core.names import in_order
from ..core.records import Track
from .network import Motions, Priors, RangeNetwork, Ranges

STEP = 0.25  # [s] between two poses that are estimated, at least; between, odometry carries a range's ends
BEYOND = 0.3  # [s] before the first odometry or after the last in which a robot is taken to be where that is
# What odometry errs by: along and across over the way [m/sqrt(m)], the heading over the way [rad/sqrt(m)] and over the
# turn [rad/sqrt(rad)], and what a standing robot may have been pushed about [m/sqrt(s)], [rad/sqrt(s)].
ALONG, ACROSS, DRIFT, TURN, REST_XY, REST_THETA = 0.03, 0.015, 0.03, 0.04, 1e-3, 1e-3


@dataclass(frozen=True, slots=True)
class RangeLog:
    """odometry: robot -> its track in a frame of its own; a, b: (k,) who ranged to whom, into `names`, robots first;

    t: (k,) [s]; z: (k,) [m]; antennas: name -> where its antenna stands on the robot [m, m]; known: beacons whose
    place is known, with their sd [m]; fixes: of robots; dropped: reason -> rows.
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


def network_of(log: RangeLog) -> RangeNetwork:
    """The network of `log`: ranges that cannot be are left out and counted, beacons nobody ranged to are not there."""
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
    ends = []
    for which in (log.a[kept], log.b[kept]):
        node, lever = np.zeros(len(which), np.int64), np.zeros((len(which), 2))
        for k in np.unique(which).tolist():
            mine, name = which == k, log.names[k]
            if name in beacons:
                node[mine] = n + beacons.index(name)
                continue
            r = robots.index(name)
            track, at = tracks[r], instants[r]
            nearest = np.clip(np.searchsorted(track.t[at], log.t[kept][mine], side="right") - 1, 0, len(at) - 1)
            here = se2.interpolate(np.clip(log.t[kept][mine], track.t[0], track.t[-1]), track.t, track.pose)
            node[mine] = starts[r] + nearest
            lever[mine] = se2.act(se2.between(track.pose[at][nearest], here), log.antennas.get(name, np.zeros(2)))
        ends.append((node, lever))
    (a, lever_a), (b, lever_b) = ends
    ranges = Ranges(a, b, log.t[kept], log.z[kept], np.full(len(kept), np.nan), lever_a, lever_b)
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
    keep = np.ones(len(log.z), bool)
    span = np.array(
        [[log.odometry[n].t[0], log.odometry[n].t[-1]] if n in robots else [-np.inf, np.inf] for n in log.names]
    )
    span = span.reshape(-1, 2) + np.array([-BEYOND, BEYOND])
    outside = np.zeros(len(log.z), bool)
    for end in (log.a, log.b):
        outside |= (log.t < span[end, 0]) | (log.t > span[end, 1])
    for reason, bad in (
        ("range to itself", log.a == log.b),
        ("range that is no positive number", ~(np.isfinite(log.z) & (log.z > 0))),
        ("range while odometry is silent", outside),
    ):
        wrong = bad & keep
        keep &= ~bad
        if wrong.any():
            dropped[reason] = dropped.get(reason, 0) + int(wrong.sum())
    rows = np.flatnonzero(keep)
    return rows[np.argsort(log.t[rows], kind="stable")], dropped


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
    return z, np.column_stack([ALONG**2 * way + xy, ACROSS**2 * way + xy, DRIFT**2 * way + theta])
