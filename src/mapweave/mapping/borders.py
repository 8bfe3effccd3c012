"""Over a border between segments: of the places where what came after may lie, the one that both sides' views allow.

In a building that looks alike in several places many more places may be found at a false one than at the right one. But
there one side saw through what the other saw as walls, as between the maps of two robots.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..laser.closures import Matched
from ..laser.keyframes import carried
from ..laser.place_search import Fit
from .keyframe_graph import CARRIED, ELSEWHERE, NEAR, KeyframeGraph
from .map_overlap import KeyframeMap
from .merge_search import (
    AGREE,
    AGREE_TURN,
    LEAST_ALIKE,
    Candidate,
    Hypothesis,
    apart,
    candidates,
    hypotheses,
    same_place,
)
from .segments import LONG, REFUSED, WHEELED

LEAD = 2.5  # times the evidence of any other place that leaves no doubt
LENIENT = 2.0  # times the share that two maps contradict of themselves, and
BENDS = 0.01  # besides, for they bend: so much of what both saw may be unlike where they meet. Of maps in which people
# walk that is nearly all: then another place may fit, too, but the best is the one that `LEAST_ALIKE` says
SURELY = 1.0 - LENIENT * BENDS  # of it is alike where maps that nothing moved in meet: if less is, any other is doubt
MOST_PAIRS = 5000  # of submaps of what came before and after that are searched: a second or two, however far it drove
HELD = np.array([40.0, 40.0])  # points that hold a place which the search has let through, at least


def decide_borders(graph: KeyframeGraph) -> tuple[int, ...]:
    """Places over a border that lie elsewhere than what both sides saw agrees are left out, and the graph is settled.

    Each segment of some length is laid where its places put it among all before it. Where wheels lead they decide, and
    where it fits nowhere without contradiction (people, outdoors, bent walls) all places stay as they were decided. A
    short one stays near what came before it or after it: no robot is carried twice at once.
    Returns the keyframes whose segments fit elsewhere about as well.
    """
    cuts = [i for i, node in enumerate(graph.nodes) if i and node.border]
    segment = np.searchsorted(np.array(cuts, dtype=np.int64), np.arange(len(graph)), side="right")
    ends = np.array([(c.first, c.second) for c in graph.closures], dtype=np.int64).reshape(-1, 2)
    low, high = np.sort(segment[ends], axis=1).T
    if not (low < high).any():
        return ()
    first = np.array([0, *cuts])
    last = np.array([*(k - 1 for k in cuts), len(graph) - 1])
    long = graph.path[last] - graph.path[first] >= LONG
    alone = graph.copy()
    alone.closures = [c for c, within in zip(graph.closures, low == high, strict=True) if within]
    alone.settle()
    unclear = []
    for s, k in enumerate(cuts, start=1):
        after, over = np.flatnonzero(segment == s), np.flatnonzero((high == s) & (low < s)).tolist()
        since = _since(graph, cuts[:s], long)
        if not over or not long[s] or not since:
            continue
        a, b, found, ways = _ways(graph, k, over, alone.pose[after])
        alike = 1.0 - min(LENIENT * (a.own + b.own + BENDS), 1.0)
        best = max(ways, key=lambda c: c.evidence(max(alike, LEAST_ALIKE)))
        if best.evidence(min(alike, LEAST_ALIKE)) <= 0.0:
            continue
        rival = max((c.evidence(alike) for c in ways if not same_place(b, c.transform, best.transform)), default=0.0)
        if rival > 0.0 and (best.seen.share < SURELY or LEAD * rival >= best.evidence(alike)):
            unclear.append(k)
        share = f"{100.0 * best.seen.share:.0f} % of what both sides saw is alike"
        away = apart(b, found, best.transform, 2.0 * AGREE, 2.0 * AGREE_TURN) > 1.0
        _leave_out(graph, np.array(over)[away], share)
        if away.all():
            for h in best.members:
                _tie(graph, h, a.pose[h.at], k, share)
        carried_off = _away(graph, since[0] - 1, k, best.transform) > CARRIED
        if carried_off:
            graph.carried |= {next((i for i in since if graph.nodes[i].border == REFUSED), k)}
        if carried_off or away.any():
            graph.settle()
    _hold_short(graph, segment, first, last, long)
    return tuple(unclear)


def _since(graph: KeyframeGraph, cuts: Sequence[int], long: Bool[np.ndarray, " s"]) -> Sequence[int]:
    """Of the cuts those since a segment of some length; none where none came before or wheels lead over all."""
    before = np.flatnonzero(long[: len(cuts)])
    since = cuts[int(before[-1]) :] if len(before) else []
    return since if any(graph.nodes[i].border not in WHEELED for i in since) else []


def _ways(
    graph: KeyframeGraph, k: int, over: Sequence[int], pose: Float[np.ndarray, "m 3"]
) -> tuple[KeyframeMap, KeyframeMap, list[Hypothesis], list[Candidate]]:
    """The maps before keyframe `k` and of its segment, places `over` the border, and transforms that are possible.

    pose: of the segment's keyframes. Not only what those places tell: they are what leaves no doubt to who looks at a
    few metres, and of rooms that look alike all may be of the wrong one.
    """
    a = _map(graph, np.arange(k), np.asarray(graph.pose[:k]))
    b = _map(graph, np.arange(k, k + len(pose)), np.asarray(se2.between(pose[0], pose)))
    found = [_hypothesis(graph, n, k, b) for n in over]
    return a, b, found, [*candidates(a, b, found), *candidates(a, b, hypotheses(a, b, MOST_PAIRS))]


def _hold_short(
    graph: KeyframeGraph,
    segment: Int[np.ndarray, " n"],
    first: Int[np.ndarray, " s"],
    last: Int[np.ndarray, " s"],
    long: np.ndarray,
) -> None:
    """Places that put a segment of no length far from the long ones before and after it are left out."""
    false = []
    for n, c in enumerate(graph.closures):
        i, j = sorted((c.first, c.second))
        if not c.accepted or segment[i] == segment[j]:
            continue
        for at, other, seen in ((c.second, c.first, c.measured), (c.first, c.second, se2.inverse(c.measured))):
            s = segment[at]
            if long[s]:
                continue
            pose = np.asarray(se2.compose(graph.pose[other], seen))
            before, after = np.flatnonzero(long[:s]), s + 1 + np.flatnonzero(long[s + 1 :])
            near = [_away(graph, int(last[before[-1]]), at, pose)] if len(before) else []
            near += [_away(graph, int(first[after[0]]), at, pose)] if len(after) else []
            if near and min(near) > NEAR**2:
                false.append(n)
                break
    if false:
        _leave_out(graph, false, "it would have been carried twice")
        graph.settle()


def _tie(graph: KeyframeGraph, h: Hypothesis, at: Float[np.ndarray, "3"], k: int, share: str) -> None:
    """A place that the search among places that leave no doubt had not found is on record, and holds."""
    measured, information = se2.between(at, h.fit.pose), np.linalg.inv(h.fit.covariance)
    found = Matched(True, share, measured, information, np.zeros(3), h.fit.share, None, h.score, h.ratio * h.score)
    graph.close(h.at, k + h.anchor, found)


def _leave_out(graph: KeyframeGraph, closures: Sequence[int] | Int[np.ndarray, " k"], why: str) -> None:
    for n in np.asarray(closures, dtype=np.int64).tolist():
        graph.closures[n] = replace(graph.closures[n], accepted=False, reason=f"{ELSEWHERE}, where {why}")


def _away(graph: KeyframeGraph, start: int, end: int, pose: Float[np.ndarray, "3"]) -> float:
    """How far `pose` lies from where the steps from keyframe `start` put keyframe `end` of its robot [squared sd]."""
    low, high = sorted((start, end))
    step, cov = np.zeros(3), np.zeros((3, 3))
    for node in graph.nodes[low + 1 : high + 1]:
        step, cov = np.asarray(se2.compose(step, node.step)), carried(cov, node.step) + node.cov
    seen = se2.between(graph.pose[start], pose)
    off = se2.between(step, seen if start == low else se2.inverse(seen))
    return float(off @ np.linalg.solve(cov, off))


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
