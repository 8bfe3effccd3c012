"""Headings of robots that share no axis, from robots that sighted each other; how two robots' odometry frames lie."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ..core import se2
from ..core.se2 import wrap_angle
from .network import BearingNetwork

TURNS = 90  # headings tried around the circle


def relative_odometry_frame(
    pose_i: Float[np.ndarray, "m 3"],
    pose_j: Float[np.ndarray, "m 3"],
    bearing: Float[np.ndarray, " m"],
    by_i: np.ndarray,
    limit: float = 0.1,
) -> tuple[Float[np.ndarray, "3"], float]:
    """T_i_j, the pose of robot j's odometry frame in robot i's, and the mean squared bearing error it leaves [rad^2].

    pose_i, pose_j: both robots in their own frames at m instants; bearing: (m,) of the other in the observer's frame;
    by_i: (m,) whether robot i was the observer; a sighting more
    than `limit` [rad] off counts as that much off. For a given turn between the frames the offset follows from linear
    least squares, so only the turn is searched.
    """
    tried = np.linspace(-np.pi, np.pi, TURNS, endpoint=False)
    tried_offsets = [_offset(pose_i, pose_j, bearing, by_i, turn, limit) for turn in tried]
    for width in (np.pi / TURNS, np.pi / TURNS / 4, np.pi / TURNS / 16):
        best = min(tried_offsets, key=lambda f: f[1])
        tried_offsets += [
            _offset(pose_i, pose_j, bearing, by_i, float(best[0][2]) + d * width, limit) for d in (-1.0, -0.5, 0.5, 1.0)
        ]
    return min(tried_offsets, key=lambda f: f[1])


def _offset(
    pose_i: np.ndarray, pose_j: np.ndarray, bearing: np.ndarray, by_i: np.ndarray, turn: float, limit: float
) -> tuple[Float[np.ndarray, "3"], float]:
    c, s = np.cos(turn), np.sin(turn)
    q = np.column_stack([c * pose_j[:, 0] - s * pose_j[:, 1], s * pose_j[:, 0] + c * pose_j[:, 1]])
    ray = np.where(by_i, pose_i[:, 2], pose_j[:, 2] + turn) + bearing
    n = np.column_stack([-np.sin(ray), np.cos(ray)])
    gap = pose_i[:, :2] - q  # the offset that would put j upon i
    scale = np.ones(len(n))
    a = np.zeros(2)
    for _ in range(3):
        A = n / scale[:, None]
        a = np.linalg.lstsq(A, np.sum(A * gap, axis=1), rcond=None)[0]
        scale = np.maximum(np.linalg.norm(a - gap, axis=1), 0.2)
    d = np.where(by_i[:, None], a - gap, gap - a)
    e = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - ray)
    return np.array([a[0], a[1], turn]), float(np.mean(np.minimum(e * e, limit**2)))


SWEEPS = 30  # of averaging each heading with those of the robots it is tied to
WILD = 0.3  # [rad]; a sighting of an anchor further off counts as this much off


def mutual_pairs(net: BearingNetwork) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Sightings a and b of each pair of robots that sighted each other (the first of repeated ones)."""
    n = len(net)
    key, back = net.observer * n + net.target, net.target * n + net.observer
    distinct, first = np.unique(key, return_index=True)
    where = np.searchsorted(distinct, back[first])
    mutual = (where < len(distinct)) & (distinct[np.minimum(where, len(distinct) - 1)] == back[first])
    a, b = first[mutual], first[where[mutual]]
    once = net.observer[a] < net.observer[b]
    return a[once], b[once]


def mutual_headings(net: BearingNetwork) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Headings [rad] up to one turn for all, and of whom: two robots that see each other look along the same line.

    A spanning tree of the largest component of the mutual sightings, then sweeps of circular averaging over all of
    them.
    """
    n = len(net)
    a, b = mutual_pairs(net)
    i, j = net.observer[a], net.target[a]
    turn = np.asarray(wrap_angle(net.bearing[b] + np.pi - net.bearing[a]))  # heading_i - heading_j
    ends = (np.r_[i, j], np.r_[j, i])
    offset = sp.csr_array((np.exp(1j * np.r_[turn, -turn]), ends), shape=(n, n))
    _, label = connected_components(offset.astype(bool), directed=False)
    known = label == np.argmax(np.bincount(label))
    if np.count_nonzero(known) < 2:
        return np.zeros(n), np.zeros(n, dtype=bool)
    z = np.zeros(n, dtype=complex)
    root = int(np.flatnonzero(known)[0])
    z[root] = 1.0
    order, before = breadth_first_order(offset.astype(bool), root, directed=False)
    for k in order[1:]:
        z[k] = offset[k, before[k]] * z[before[k]]
    for _ in range(SWEEPS):
        z = z + offset @ z
        z[known] /= np.abs(z[known])
    return np.angle(z), known


def beacon_headings(net: BearingNetwork) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Headings [rad] of robots that see three anchors or more, and who they are: each alone, without a guess."""
    heading, known = np.zeros(len(net)), np.zeros(len(net), dtype=bool)
    rows = np.flatnonzero(net.is_anchor[net.target] & ~net.is_anchor[net.observer])
    rows = rows[np.argsort(net.observer[rows], kind="stable")]
    if not len(rows):
        return heading, known
    robots, first = np.unique(net.observer[rows], return_index=True)
    for k, mine in zip(robots.tolist(), np.split(rows, first[1:]), strict=True):
        seen = net.target[mine]
        if len(np.unique(seen)) < 3:
            continue
        there = np.array([[*net.anchors[int(j)], 0.0] for j in seen])
        pose, _ = relative_odometry_frame(
            there, np.zeros_like(there), net.bearing[mine], np.zeros(len(mine), dtype=bool), WILD
        )
        heading[k], known[k] = pose[2], True
    return heading, known


def resected_headings(
    net: BearingNetwork, position: np.ndarray, placed: np.ndarray, heading: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Headings also of placed robots that see placed ones: the mean turn from what they see to where it is."""
    rows = placed[net.observer] & placed[net.target] & ~known[net.observer]
    i, j = net.observer[rows], net.target[rows]
    d = position[j] - position[i]
    turn = np.exp(1j * (np.arctan2(d[:, 1], d[:, 0]) - net.bearing[rows]))
    total = np.zeros(len(net), dtype=complex)
    np.add.at(total, i, turn)
    fresh = np.zeros(len(net), dtype=bool)
    fresh[i] = True
    return np.where(fresh, np.angle(total), heading), known | fresh


def headings_at(net: BearingNetwork, position: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Headings [rad] that fit what each robot sees with all robots at `position`; zero of those that see nobody."""
    everybody, nobody = np.ones(len(net), dtype=bool), np.zeros(len(net), dtype=bool)
    return resected_headings(net, position, everybody, np.zeros(len(net)), nobody)[0]


def anchored_turn(net: BearingNetwork, position: Float[np.ndarray, "n 2"], chosen: np.ndarray) -> float:
    """The turn [rad] that carries a shape onto its anchors best (place and scale free)."""
    at = np.array([k for k in net.anchors if chosen[k]], dtype=np.intp)
    here = position[at] @ np.array([1.0, 1j])
    there = np.array([net.anchors[int(k)] for k in at]) @ np.array([1.0, 1j])
    return float(np.angle(np.vdot(here - here.mean(), there - there.mean())))


def world_directions(net: BearingNetwork, heading: np.ndarray | None) -> Float[np.ndarray, "m d"]:
    """Sightings as unit vectors in the common axes."""
    if heading is None:
        return net.direction
    z = net.bearing + heading[net.observer]
    return np.stack([np.cos(z), np.sin(z)], axis=1)
