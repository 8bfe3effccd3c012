"""A common axis for robots that have none, agreed on by talking to those they see or are seen by.

Robots that sighted each other share their headings up to one turn: word goes round from one of them, then everybody
averages. In that frame the linear start is a sum of two, one for each component of the anchors' direction, and what is
left over tells the turn: two numbers that all add to and hear of along the paths on which word went round.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import breadth_first_order

from ..core.errors import DataError
from ..core.se2 import rotation, wrap_angle
from .headings import (
    SWEEPS,
    beacon_headings,
    headings_at,
    mutual_headings,
    mutual_pairs,
    resected_headings,
    world_directions,
)
from .network import BearingNetwork
from .result import FLOAT, Traffic

ROUNDS = 20  # of spreading headings from robots that see each other to those that only see
FLAT = 1e-3  # share of a robot's stiffer direction below which the other is not held by its sightings

Relaxed = Callable[[BearingNetwork], tuple[np.ndarray, Traffic]]


def agree_on_axis(
    net: BearingNetwork, relaxed: Relaxed, initial: Float[np.ndarray, "n 2"] | None = None
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"], Traffic]:
    """Positions, headings [rad], whose heading is known, and what was said; with `initial` nothing had to be.

    relaxed: the linear start of a network whose sightings are against a common axis. Raises DataError when no heading
    can be started.
    """
    n = len(net)
    if initial is not None:
        return initial.copy(), headings_at(net, initial), np.ones(n, dtype=bool), Traffic(0, 0, 0)
    heading, known = mutual_headings(net)
    said, turned = _averaged(net), False
    if not known.any():
        turned = True
        heading, known = beacon_headings(net)
    if not known.any():
        what = "no two robots sighted each other and none sees three anchors"
        raise DataError(f"no axis is common, {what}: no heading can be started")
    position = np.zeros((n, 2))
    for _ in range(ROUNDS):
        rows = known[net.observer]
        directions = world_directions(net, heading)[rows]
        flat = replace(net.select(rows), bearing=np.arctan2(directions[:, 1], directions[:, 0]), axis=True)
        if turned:
            position, more = relaxed(flat)
        else:
            position, turn, more = _with_turn(flat, relaxed)
            heading, turned = np.asarray(wrap_angle(heading + turn)), True
        said = said + more
        heading, more_known = resected_headings(net, position, _held(flat, position), heading, known)
        if (more_known == known).all():
            break
        known = more_known
    return position, heading, known, said


def _averaged(net: BearingNetwork) -> Traffic:
    """The messages that `mutual_headings` takes: along a spanning tree from one robot to all, then in every sweep."""
    a, _ = mutual_pairs(net)
    each = 2 * len(a)
    rounds = SWEEPS + (_depth(net) if each else 0)
    return Traffic(rounds if each else 0, each * (1 + SWEEPS), each * (1 + SWEEPS) * 2 * FLOAT)


def _depth(net: BearingNetwork) -> int:
    """Steps from the first robot that sights somebody to the one furthest from it."""
    graph = sp.csr_array((np.ones(len(net.observer)), (net.observer, net.target)), shape=(len(net), len(net)))
    order, before = breadth_first_order(graph, int(net.observer[0]), directed=False)
    depth = np.zeros(len(net), dtype=int)
    for k in order[1:]:
        depth[k] = depth[before[k]] + 1
    return int(depth.max())


def _with_turn(net: BearingNetwork, relaxed: Relaxed) -> tuple[Float[np.ndarray, "n 2"], float, Traffic]:
    """Positions and the turn [rad] of a network whose sightings share an axis that lies anyhow to the anchors."""
    middle = np.mean(list(net.anchors.values()), axis=0)
    q, said = [], Traffic(0, 0, 0)
    for across in (np.eye(2), rotation(-np.pi / 2)):  # what the anchors are, turned back by 0 and by 90 degrees
        start, more = relaxed(replace(net, anchors={k: across @ (p - middle) for k, p in net.anchors.items()}))
        q.append(start)
        said = said + more
    u = net.direction
    span = np.stack([start[net.target] - start[net.observer] for start in q])  # (2, m, 2)
    off = u[:, 0] * span[..., 1] - u[:, 1] * span[..., 0]  # (2, m)
    cosine, sine = np.linalg.eigh(off @ off.T)[1][:, 0]
    if (cosine * span[0] + sine * span[1]).ravel() @ u.ravel() < 0:
        cosine, sine = -cosine, -sine
    turn = float(np.arctan2(sine, cosine))
    each = 2 * (len(net) - 1)  # sums go up the paths to one robot, and the turn comes down
    added = Traffic(2 * _depth(net), each, each // 2 * (5 + 2) * FLOAT)
    return (cosine * q[0] + sine * q[1]) @ rotation(turn).T + middle, turn, said + added


def _held(net: BearingNetwork, position: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Whose place its sightings hold in both directions, as far as its neighbours can tell."""
    i, j = net.observer, net.target
    d = position[j] - position[i]
    u = d / np.maximum(np.linalg.norm(d, axis=1), 1e-12)[:, None]
    D = np.zeros((len(net), 2, 2))
    for end in (i, j):
        np.add.at(D, end, np.eye(2) - u[:, :, None] * u[:, None, :])
    low, high = np.linalg.eigvalsh(D).T
    return np.asarray((low > FLAT * np.maximum(high, 1e-12)) | net.is_anchor)
