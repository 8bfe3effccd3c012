"""A robot hands its submap over: constrained fusion into the global map, after which the submap starts empty.

It replaces [Yuan09]'s eq. 14, which covers neither new landmarks, nor the next frame, nor the rest of the submap:
the joint state of map and submap is conditioned on "a landmark both know is one point", then mapped forward whole.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import symmetrise
from ..core.names import unused
from ..core.records import owned
from ..landmarks.landmark_map import GlobalMap, Submap
from .map_and_submap import PAIRING, MapAndSubmap, PairingConfig, merge_duplicates, ordered_pair


@dataclass(frozen=True, slots=True)
class Handover:
    """The global map afterwards; what each submap landmark is called there; (kept, dropped) of duplicates merged.

    names: `None` for a landmark left out. A dropped name may be given to another landmark later.
    """

    map: GlobalMap
    names: tuple[str | None, ...]
    matched: tuple[bool, ...]
    merged: tuple[tuple[str, str], ...] = ()


def hand_over(
    G: GlobalMap,
    L: Submap,
    *,
    known: bool,
    prefix: str = "",
    cfg: PairingConfig = PAIRING,
) -> Handover:
    """`G` with all that `L` knows: matched landmarks fused, the others added, the robot's frame moved to its pose.

    With `known` identities equal ids are one landmark. Otherwise pairs inside the gate of `cfg` are weighed together,
    over all ways to pair (`pairing_probabilities`), and those that are surely one are fused. A landmark that may be new
    is added, and merged later if it turns out to be an old one; one that is surely old, with no telling which, is left
    out. Landmarks of one submap were told apart by it and are never merged. Unknown landmarks are named `prefix` and a
    number. Other robots' submaps are not touched: they are independent.
    """
    Y = MapAndSubmap(G, L)
    pairs: dict[int, int] = {}
    torn: frozenset[int] = frozenset()
    if known:
        where = {name: k for k, name in enumerate(G.ids)}
        pairs = {i: where[name] for i, name in enumerate(L.ids) if name in where}
        if pairs:
            Y.constrain(list(pairs.items()))
    else:
        while True:
            sure, torn = Y.sure_pairs(pairs, cfg)
            if not sure:
                break
            Y.constrain(sure)
            pairs.update(sure)
    names = _names(G, L, pairs, torn, known=known, prefix=prefix)
    out = _forward(G, Y, names, [i for i, name in enumerate(names) if name is not None and i not in pairs])
    merged: tuple[tuple[str, str], ...] = ()
    if not known:
        out = replace(out, apart=out.apart | _apart(out, [name for name in names if name is not None], cfg.apart))
        out, merged = merge_duplicates(out, cfg)
        renamed = {gone: kept for kept, gone in merged}
        names = tuple(_follow(name, renamed) for name in names)
    return Handover(out, names, tuple(i in pairs for i in range(len(L.ids))), merged)


def _apart(G: GlobalMap, names: list[str], far: float) -> frozenset[tuple[str, str]]:
    """Pairs of landmarks that are surely two: one submap holds both. Those `far` [m] apart need no such word."""
    at = [G.mean[G.ids.index(name)] for name in names]
    return frozenset(
        ordered_pair(a, b)
        for (a, p), (b, q) in combinations(zip(names, at, strict=True), 2)
        if np.hypot(*(p - q)) < far
    )


def _names(
    G: GlobalMap, L: Submap, pairs: dict[int, int], torn: frozenset[int], *, known: bool, prefix: str
) -> tuple[str | None, ...]:
    """What the map calls each landmark of `L`."""
    taken = set(G.ids)
    names: list[str | None] = []
    for i, name in enumerate(L.ids):
        if i in torn:
            names.append(None)
            continue
        label = G.ids[pairs[i]] if i in pairs else name if known else unused(prefix, taken)
        taken.add(label)
        names.append(label)
    return tuple(names)


def _forward(G: GlobalMap, Y: MapAndSubmap, names: tuple[str | None, ...], new: list[int]) -> GlobalMap:
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
    return GlobalMap(G.robots, frames, (*G.ids, *(str(names[i]) for i in new)), mean, owned(P), G.apart)


def _follow(name: str | None, renamed: dict[str, str]) -> str | None:
    while name is not None and name in renamed:
        name = renamed[name]
    return name


def pose_in_map(G: GlobalMap, L: Submap) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """`T_map_robot` and its covariance: frame and submap are independent."""
    k = 3 * G.robots.index(L.robot)
    frame = G.frames[G.robots.index(L.robot)]
    cov = se2.composed_covariance(frame, G.cov[k : k + 3, k : k + 3], L.pose, L.cov[:3, :3])
    return se2.compose(frame, L.pose), symmetrise(cov)
