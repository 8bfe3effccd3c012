"""A robot hands its submap over: constrained fusion into the global map, after which the submap starts empty.

It replaces [Yuan09]'s eq. 14, which covers neither new landmarks, nor the next frame, nor the rest of the submap:
the joint state of map and submap is conditioned on "a landmark both know is one point", then mapped forward whole.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.arrays import owned
from ..core.gaussian import symmetrise
from ..maps.global_map import GlobalMap
from ..maps.submap import Submap
from .duplicates import GATE, merge_duplicates
from .joint import Joint


@dataclass(frozen=True, slots=True)
class Handover:
    """The global map afterwards; what each submap landmark is called there; (kept, dropped) of duplicates merged."""

    map: GlobalMap
    names: tuple[str, ...]
    matched: tuple[bool, ...]
    merged: tuple[tuple[str, str], ...] = ()


def hand_over(G: GlobalMap, L: Submap, *, known: bool, gate: float = GATE, prefix: str = "") -> Handover:
    """`G` with all that `L` knows: matched landmarks fused, the others added, the robot's frame moved to its pose.

    With `known` identities equal ids are one landmark; otherwise the best pair inside `gate` is fused first, one to
    one, distances computed anew after each, and near duplicates in the map are merged at the end. Unknown landmarks
    are named `prefix` and a number. Other robots' submaps are not touched: they are independent of `L`.
    """
    Y = Joint(G, L)
    pairs: dict[int, int] = {}
    if known:
        where = {name: k for k, name in enumerate(G.ids)}
        pairs = {i: where[name] for i, name in enumerate(L.ids) if name in where}
        if pairs:
            Y.constrain(list(pairs.items()))
    else:
        while True:
            best = Y.best_pair(pairs, gate)
            if best is None:
                break
            Y.constrain([best])
            pairs[best[0]] = best[1]
    names = _names(G, L, pairs, known=known, prefix=prefix)
    out = _forward(G, Y, names, [i for i in range(len(L.ids)) if i not in pairs])
    merged: tuple[tuple[str, str], ...] = ()
    if not known:
        out, merged = merge_duplicates(out, gate)
        renamed = {gone: kept for kept, gone in merged}
        names = tuple(_follow(name, renamed) for name in names)
    return Handover(out, names, tuple(i in pairs for i in range(len(L.ids))), merged)


def _names(G: GlobalMap, L: Submap, pairs: dict[int, int], *, known: bool, prefix: str) -> tuple[str, ...]:
    """What the map calls each landmark of `L`."""
    taken = set(G.ids)
    names: list[str] = []
    for i, name in enumerate(L.ids):
        label = G.ids[pairs[i]] if i in pairs else name if known else _unused(prefix, taken)
        taken.add(label)
        names.append(label)
    return tuple(names)


def _forward(G: GlobalMap, Y: Joint, names: tuple[str, ...], new: list[int]) -> GlobalMap:
    """`XL_j <- XL_j (+) r_j`, unmatched landmarks `XL_j,old (+) l_i`: one Jacobian over all of Y.

    It is the identity but for the frame and the landmarks `new`: only their rows and columns change.
    """
    old, pose, points = Y.x[Y.frame], Y.x[Y.pose], Y.points[new]
    J = np.zeros((3 + 2 * len(new), 6 + 2 * len(new)))
    J[:3, :3], J[:3, 3:6] = se2.compose_jacobians(old, pose)
    C = se2.rotation(float(old[2]))
    for k, (x, y) in enumerate(points):
        row = slice(3 + 2 * k, 5 + 2 * k)
        J[row, :2] = np.eye(2)
        J[row, 2] = C @ np.array([-y, x])
        J[row, 6 + 2 * k : 8 + 2 * k] = C
    columns = np.concatenate([Y.frame, Y.pose, Y.point(np.array(new, dtype=np.intp)).ravel()])
    rows = J @ Y.rows(columns)
    n = len(G.cov)
    P = Y.map_covariance(2 * len(new))
    changed = np.concatenate([Y.frame, n + np.arange(2 * len(new))])
    P[changed, :n] = rows[:, :n]
    P[:n, changed] = rows[:, :n].T
    P[np.ix_(changed, changed)] = symmetrise(rows[:, columns] @ J.T)
    frames = Y.frames.copy()
    frames[Y.frame[0] // 3] = se2.compose(old, pose)
    mean = np.vstack([Y.marks, se2.act(old, points)])
    return GlobalMap(G.robots, frames, (*G.ids, *(names[i] for i in new)), mean, owned(P))


def _unused(prefix: str, taken: set[str]) -> str:
    k = len(taken)
    while f"{prefix}{k}" in taken:
        k += 1
    return f"{prefix}{k}"


def _follow(name: str, renamed: dict[str, str]) -> str:
    while name in renamed:
        name = renamed[name]
    return name


def pose_in_map(G: GlobalMap, L: Submap) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """`T_map_robot` and its covariance: frame and submap are independent."""
    k = 3 * G.robots.index(L.robot)
    frame = G.frames[G.robots.index(L.robot)]
    A, B = se2.compose_jacobians(frame, L.pose)
    return se2.compose(frame, L.pose), symmetrise(A @ G.cov[k : k + 3, k : k + 3] @ A.T + B @ L.cov[:3, :3] @ B.T)
