"""Headings of robots that share no axis, from robots that sighted each other."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ..core.se2 import wrap_angle
from .meeting import meet
from .network import Network

SWEEPS = 30
WILD = 0.3  # [rad]; a sighting of an anchor further off counts as this much off


def mutual_pairs(net: Network) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Sightings a and b of each pair of robots that sighted each other (the first of repeated ones)."""
    n = len(net)
    key, back = net.observer * n + net.target, net.target * n + net.observer
    distinct, first = np.unique(key, return_index=True)
    where = np.searchsorted(distinct, back[first])
    mutual = (where < len(distinct)) & (distinct[np.minimum(where, len(distinct) - 1)] == back[first])
    a, b = first[mutual], first[where[mutual]]
    once = net.observer[a] < net.observer[b]
    return a[once], b[once]


def mutual_headings(net: Network) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Headings [rad] up to one turn for all, and of whom: two robots that see each other look along the same line.

    A spanning tree of the largest piece of the mutual sightings, then sweeps of circular averaging over all of them.
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


def beacon_headings(net: Network) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
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
        pose, _ = meet(there, np.zeros_like(there), net.bearing[mine], np.zeros(len(mine), dtype=bool), WILD)
        heading[k], known[k] = pose[2], True
    return heading, known


def resected_headings(
    net: Network, position: np.ndarray, placed: np.ndarray, heading: np.ndarray, known: np.ndarray
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


def anchored_turn(net: Network, position: Float[np.ndarray, "n 2"], chosen: np.ndarray) -> float:
    """The turn [rad] that carries a shape onto its anchors best (place and scale free)."""
    at = np.array([k for k in net.anchors if chosen[k]], dtype=np.intp)
    here = position[at] @ np.array([1.0, 1j])
    there = np.array([net.anchors[int(k)] for k in at]) @ np.array([1.0, 1j])
    return float(np.angle(np.vdot(here - here.mean(), there - there.mean())))


def world_directions(net: Network, heading: np.ndarray | None) -> Float[np.ndarray, "m d"]:
    """Sightings as unit vectors in the common axes."""
    if heading is None:
        return net.direction
    z = net.bearing + heading[net.observer]
    return np.stack([np.cos(z), np.sin(z)], axis=1)
