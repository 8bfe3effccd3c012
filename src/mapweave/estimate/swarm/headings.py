"""Headings of robots that share no axis, from robots that sighted each other."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ...core.se2 import wrap_angle
from ...maps.network import Network

SWEEPS = 30


def mutual_pairs(net: Network) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Sightings a and b of each pair of robots that sighted each other (the first of repeated ones)."""
    n = len(net)
    key, back = net.observer * n + net.target, net.target * n + net.observer
    distinct, first = np.unique(key, return_index=True)
    where = np.searchsorted(distinct, back[first])
    found = (where < len(distinct)) & (distinct[np.minimum(where, len(distinct) - 1)] == back[first])
    a, b = first[found], first[where[found]]
    once = net.observer[a] < net.observer[b]
    return a[once], b[once]


def heading_start(net: Network) -> Float[np.ndarray, " n"]:
    """Headings [rad] up to one turn for all: two robots that see each other look along the same line.

    A spanning tree of the mutual sightings, then sweeps of circular averaging over all of them. Robots without a
    mutual sighting keep 0 here and are found with their positions.
    """
    n = len(net)
    a, b = mutual_pairs(net)
    i, j = net.observer[a], net.target[a]
    turn = np.asarray(wrap_angle(net.bearing[b] + np.pi - net.bearing[a]))  # heading_i - heading_j
    graph = sp.csr_array((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(n, n))
    offset = sp.csr_array((np.exp(1j * np.r_[turn, -turn]), (np.r_[i, j], np.r_[j, i])), shape=(n, n))
    z = np.zeros(n, dtype=complex)
    count, label = connected_components(graph, directed=False)
    for c in range(count):
        root = int(np.flatnonzero(label == c)[0])
        z[root] = 1.0
        order, before = breadth_first_order(graph, root, directed=False)
        for k in order[1:]:
            z[k] = offset[k, before[k]] * z[before[k]]
    for _ in range(SWEEPS):
        z = z + offset @ z
        z /= np.maximum(np.abs(z), 1e-300)
    return np.angle(z)


def world_directions(net: Network, heading: np.ndarray | None) -> Float[np.ndarray, "m d"]:
    """Sightings as unit vectors in the common axes."""
    if heading is None:
        return net.direction
    z = net.bearing + heading[net.observer]
    return np.stack([np.cos(z), np.sin(z)], axis=1)
