"""Over a border between segments: of the places where what came after may lie, the one that both sides' views allow.

In a building that looks alike in several places many more places may be found at a false one than at the right one. But
there one side saw through what the other saw as walls, as between the maps of two robots.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..laser.place_search import Fit
from .keyframe_graph import ELSEWHERE, KeyframeGraph
from .map_overlap import KeyframeMap
from .merge_search import AGREE, AGREE_TURN, LEAST_ALIKE, Hypothesis, apart, candidates, same_place
from .segments import GAP, LONG

LEAD = 2.0  # times the evidence of any other place that leaves no doubt
HELD = np.array([40.0, 40.0])  # points that hold a place which the search has let through, at least


def decide_borders(graph: KeyframeGraph) -> tuple[int, ...]:
    """Places over a border that lie elsewhere than what both sides saw agrees are left out, and the graph is settled.

    Each segment of some length is laid where its places put it among all before it. After a gap wheels decide, and
    where it fits nowhere without contradiction (people, outdoors, bent walls) all places stay as they were decided.
    Returns the keyframes whose segments fit elsewhere about as well.
    """
    cuts = [i for i, node in enumerate(graph.nodes) if i and node.border]
    segment = np.searchsorted(np.array(cuts, dtype=np.int64), np.arange(len(graph)), side="right")
    ends = np.array([(c.first, c.second) for c in graph.closures], dtype=np.int64).reshape(-1, 2)
    low, high = np.sort(segment[ends], axis=1).T
    if not (low < high).any():
        return ()
    alone = graph.copy()
    alone.closures = [c for c, within in zip(graph.closures, low == high, strict=True) if within]
    alone.settle()
    unclear = []
    for s, k in enumerate(cuts, start=1):
        after, over = np.flatnonzero(segment == s), np.flatnonzero((high == s) & (low < s)).tolist()
        if not over or graph.nodes[k].border == GAP or graph.path[after[-1]] - graph.path[k] < LONG:
            continue
        a = _map(graph, np.arange(k), np.asarray(graph.pose[:k]))
        b = _map(graph, after, np.asarray(se2.between(alone.pose[k], alone.pose[after])))
        found = [_hypothesis(graph, n, k, b) for n in over]
        ways = [(c.evidence(LEAST_ALIKE), c) for c in candidates(a, b, found)]
        most, best = max(ways, key=lambda way: way[0])
        if most <= 0.0:
            continue
        others = [e for e, c in ways if not same_place(b, c.transform, best.transform)]
        if LEAD * max(others, default=0.0) > most:
            unclear.append(k)
        away = apart(b, found, best.transform, 2.0 * AGREE, 2.0 * AGREE_TURN) > 1.0
        false = [n for n, is_away in zip(over, away.tolist(), strict=True) if is_away]
        for n in false:
            share = f"{100.0 * best.seen.share:.0f} % of what both sides saw is alike"
            graph.closures[n] = replace(graph.closures[n], accepted=False, reason=f"{ELSEWHERE}, where {share}")
        if false:
            graph.settle()
    return tuple(unclear)


def _map(graph: KeyframeGraph, rows: Int[np.ndarray, " k"], pose: Float[np.ndarray, "k 3"]) -> KeyframeMap:
    nodes = [graph.nodes[i] for i in rows.tolist()]
    return KeyframeMap("", pose, [n.beams.s for n in nodes], None, border=[n.border for n in nodes])


def _hypothesis(graph: KeyframeGraph, n: int, k: int, b: KeyframeMap) -> Hypothesis:
    """Place number `n`, found over the border before keyframe `k`, as one of map `b`, which begins with that."""
    c = graph.closures[n]
    swapped = c.first >= k
    at, anchor = (c.second, c.first - k) if swapped else (c.first, c.second - k)
    measured = se2.inverse(c.measured) if swapped else c.measured
    pose = np.asarray(se2.compose(graph.pose[at], measured))
    fit = Fit(pose, np.linalg.inv(c.information), 0, c.share, 0.0, HELD, np.array([1.0, 0.0]))
    score = c.score or 0.0
    transform = np.asarray(se2.compose(pose, se2.inverse(b.pose[anchor])))
    return Hypothesis(at, anchor, transform, score, (c.runner_up or 0.0) / max(score, 1e-9), fit)
