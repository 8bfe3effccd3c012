"""The maps of many robots woven into one: pairs merged or refused, components, one pose graph over all robots."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..laser.joint_pass import JointPassConfig, joint_pass, keyframe_cloud
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from ..laser.robust_graph import RobustGraphConfig, SolvedGraph, connected, solve_graph
from .map_overlap import OVERLAP, KeyframeMap, OverlapConfig
from .merge import Merge, merge_maps
from .merge_search import MergeConfig, Start, start_between
from .segments import pieces_of


@dataclass(frozen=True, slots=True)
class Woven:
    """What became of M robots' maps.

    merges: every pair tried, in order; component: (M,) which robots are connected, 0 that of the first robot; pose: of
    each robot's keyframes (n, 3) in the frame of its component, which is that of its lowest robot, after the last
    pass over all of them together; of a robot alone: its own. joint: the pose graph over all robots, keyframes in the
    robots' order, and what was dropped from it. held: of each robot the pieces (by `pieces_of`, but for the first) that
    others tie to one before them.
    """

    merges: tuple[Merge, ...]
    component: Int[np.ndarray, " M"]
    pose: tuple[Float[np.ndarray, "_ 3"], ...]
    joint: SolvedGraph
    held: tuple[tuple[int, ...], ...] = ()


class Piece(NamedTuple):
    """Keyframes `rows` of robot number `robot`, whose places hold together."""

    robot: int
    rows: Int[np.ndarray, " k"]


def keyframe_map(
    graph: RobotGraph, cfg: OverlapConfig = OVERLAP, keep: Int[np.ndarray, " k"] | None = None
) -> KeyframeMap:
    """The keyframes of one robot, or those to `keep`, as merging wants them."""
    keep = np.arange(len(graph)) if keep is None else keep
    rows = [graph.rows(i) for i in keep.tolist()]
    q = None if graph.q is None else [graph.q[r] for r in rows]
    border = [graph.border[i] for i in keep.tolist()]
    return KeyframeMap(graph.robot, graph.pose[keep], [graph.points[r] for r in rows], q, cfg, border)


def weave(
    robots: Sequence[RobotGraph],
    cfg: MergeConfig | None = None,
    starts: Mapping[int, Start] | None = None,
    *,
    merge: bool = True,
    last: JointPassConfig | None = None,
    known: Mapping[tuple[int, int], Merge] | None = None,
    executor: Executor | None = None,
) -> Woven:
    """One map of all robots that can be tied together, each in its place; the others on their own.

    What is laid on what is each robot's pieces, so that one of them may join two that nothing else ties. starts: by
    place in `robots`, where a robot's frame is said to lie in that of the first. merge: False leaves every robot alone.
    Pieces are tried against those of the robots before; one that is tied in already is not tried again with a piece it
    is tied to, and a tie that the joint graph drops is no tie.

    last: how all keyframes of a component are matched in the end. known: what was decided earlier on pairs of these
    robots, when there was less of them: taken as it stands, its closures by their keyframes. executor: where pairs are
    tried side by side, those too that are not needed then: what comes of it is the same.
    """
    cfg, known = cfg or MergeConfig(), known or {}
    pieces = [Piece(k, rows) for k, robot in enumerate(robots) for rows in pieces_of(robot)]
    of = [[p for p, piece in enumerate(pieces) if piece.robot == k] for k in range(len(robots))]
    offset = np.concatenate([[0], np.cumsum([len(r) for r in robots])])
    start = np.concatenate([r.pose for r in robots])
    graph = _side_by_side([r.graph() for r in robots], start)
    within = graph.edges
    merges: list[Merge] = []
    frames = _Frames(len(pieces))
    tried = _tried(robots, pieces, cfg, starts or {}, known, executor if merge else None)
    for j in range(1, len(robots)) if merge else ():
        for i in range(j):
            decided = []
            for p, q in product(of[i], of[j]):
                if frames.group[p] == frames.group[q]:
                    continue
                if (i, j) in known:
                    p, q = (_holding(pieces, of[k], known[i, j], end) for k, end in ((i, "first"), (j, "second")))  # noqa: PLW2901
                decision = known.get((i, j)) or tried(p, q)
                decided.append(decision)
                if decision.transform is not None:
                    graph = graph.joined(_ties(decision, start, int(offset[i]), int(offset[j]), cfg.ties_alike))
                    frames.tie(p, q, decision.transform)
                if (i, j) in known:
                    break
            merges += [_as_one(decided)] if decided else []
    placed = np.array(start)
    for k, robot in enumerate(robots):
        for p in of[k]:
            rows = pieces[p].rows
            placed[offset[k] + rows] = se2.compose(frames.of(p, of[k]), robot.pose[rows])
    graph = PoseGraph(placed, graph.first, graph.second, graph.measured, graph.information)
    doubtful = np.arange(graph.edges) >= within
    joint = solve_graph(graph, RobustGraphConfig(method="cauchy"), doubtful=doubtful)
    held = tuple(
        tuple(k for k, p in enumerate(own) if k and frames.group[p] in {frames.group[o] for o in own[:k]}) for own in of
    )
    return _placed(robots, joint, within, tuple(merges), last or JointPassConfig(), held)


class _Frames:
    """Where the frame of each piece's robot stands by what ties it, and which pieces are tied. `tie` changes it."""

    def __init__(self, many: int) -> None:
        self.at, self.group = [np.zeros(3) for _ in range(many)], list(range(many))

    def tie(self, p: int, q: int, transform: Float[np.ndarray, "3"]) -> None:
        """Piece q's frame is seen at `transform` from p's: the group that comes later moves."""
        shift = se2.compose(se2.compose(self.at[p], transform), se2.inverse(self.at[q]))
        old, new = max(self.group[p], self.group[q]), min(self.group[p], self.group[q])
        if self.group[p] != new:
            shift = se2.inverse(shift)
        for k, g in enumerate(self.group):
            if g == old:
                self.at[k], self.group[k] = se2.compose(shift, self.at[k]), new

    def of(self, p: int, own: Sequence[int]) -> Float[np.ndarray, "3"]:
        """Of piece p; where nothing ties it that of the next of its robot's `own` before it, or after it, that is."""
        tied = [k for k in own if self.group.count(self.group[k]) > 1] or [p]
        return self.at[max((k for k in tied if k <= p), default=tied[0])]


def _holding(pieces: Sequence[Piece], own: Sequence[int], merge: Merge, end: str) -> int:
    """The piece that most accepted closures of a merge end in."""
    ends = np.array([getattr(c, end) for c in merge.closures if c.accepted], dtype=np.int64)
    return max(own, key=lambda p: int(np.isin(ends, pieces[p].rows).sum()))


def _as_one(decided: Sequence[Merge]) -> Merge:
    """What was decided on the pieces of two robots: that on those which most ties hold, with the closures of all."""
    best = max(decided, key=lambda m: (m.merged, m.agreeing if m.merged else 0))
    merged = [m for m in decided if m.merged]
    others = [m for m in decided if m is not best]
    closures = [*best.closures, *(replace(c, accepted=c.accepted and m.merged) for m in others for c in m.closures)]
    reason = best.reason if len(merged) < 2 else f"{best.reason}; {len(merged)} pieces of them are tied"
    return replace(best, reason=reason, closures=tuple(closures))


def _tried(
    robots: Sequence[RobotGraph],
    pieces: Sequence[Piece],
    cfg: MergeConfig,
    starts: Mapping[int, Start],
    known: Mapping[tuple[int, int], Merge],
    executor: Executor | None,
) -> Callable[[int, int], Merge]:
    """What is decided on pieces p and q of robots i < j, with an executor on all at once, else when it is asked for.

    A start tells where the piece lies that its robot began with.
    """
    maps = [keyframe_map(robots[piece.robot], cfg.overlap, piece.rows) for piece in pieces]

    def start(p: int, q: int) -> Start | None:
        first = not pieces[p].rows[0] and not pieces[q].rows[0]
        return start_between(starts, pieces[p].robot, pieces[q].robot) if first else None

    def numbered(p: int, q: int, merge: Merge) -> Merge:
        rows = pieces[p].rows, pieces[q].rows
        closures = [replace(c, first=int(rows[0][c.first]), second=int(rows[1][c.second])) for c in merge.closures]
        return replace(merge, closures=tuple(closures))

    if executor is None:
        return lambda p, q: numbered(p, q, merge_maps(maps[p], maps[q], cfg, start(p, q)))
    running = {
        (p, q): executor.submit(merge_maps, maps[p], maps[q], cfg, start(p, q))
        for p, q in combinations(range(len(pieces)), 2)
        if pieces[p].robot != pieces[q].robot and (pieces[p].robot, pieces[q].robot) not in known
    }
    return lambda p, q: numbered(p, q, running[p, q].result())


def _side_by_side(graphs: Sequence[PoseGraph], pose: Float[np.ndarray, "n 3"]) -> PoseGraph:
    """The edges of graphs whose poses stand in `pose` one after the other."""
    out, at = PoseGraph.of(pose, [], [], []), 0
    for g in graphs:
        out = out.joined(PoseGraph(pose, g.first + at, g.second + at, g.measured, g.information))
        at += len(g)
    return out


def _placed(
    robots: Sequence[RobotGraph],
    joint: SolvedGraph,
    within: int,
    merges: tuple[Merge, ...],
    last: JointPassConfig,
    held: tuple[tuple[int, ...], ...],
) -> Woven:
    """Components and poses once the joint graph is solved; its edges from number `within` on tie robots."""
    offset = np.concatenate([[0], np.cumsum([len(r) for r in robots])])
    part = connected(joint.graph, joint.used)[offset[:-1]]
    component = np.array([list(dict.fromkeys(part.tolist())).index(p) for p in part.tolist()], dtype=np.int64)
    pose = [np.asarray(r.pose) for r in robots]
    for c in range(int(component.max()) + 1):
        members = np.flatnonzero(component == c).tolist()
        if len(members) > 1:
            ties = _held_ties(joint, within, [range(offset[k], offset[k + 1]) for k in members])
            refined = _last_pass([robots[k] for k in members], ties, last)
            for k, new in zip(members, refined, strict=True):
                pose[k] = new
    return Woven(merges, component, tuple(pose), joint, held)


def _held_ties(joint: SolvedGraph, within: int, members: Sequence[range]) -> PoseGraph:
    """The ties between robots that the joint graph holds, over the keyframes of `members` alone, in their order.

    Together they count as one measurement: the last pass matches what they were made of again.
    """
    graph = joint.graph
    number = np.full(len(graph), -1, dtype=np.int64)
    number[np.concatenate([np.asarray(m) for m in members])] = np.arange(sum(len(m) for m in members))
    rows = np.flatnonzero(joint.used & (np.arange(graph.edges) >= within) & (number[graph.first] >= 0))
    pose = graph.pose[np.concatenate([np.asarray(m) for m in members])]
    return PoseGraph(
        pose,
        number[graph.first[rows]],
        number[graph.second[rows]],
        graph.measured[rows],
        graph.information[rows] / max(len(rows), 1),
    )


def _last_pass(robots: Sequence[RobotGraph], ties: PoseGraph, cfg: JointPassConfig) -> list[np.ndarray]:
    """The keyframes of connected robots after a pass over all of them, in the frame of the first."""
    size = [len(r) for r in robots]
    steps = _side_by_side([r.steps() for r in robots], ties.pose)
    owner = np.repeat(np.arange(len(robots)), size)
    refined = joint_pass(steps, keyframe_cloud(robots, cfg.beams), cfg, ties, owner)
    origin = se2.compose(refined[0], se2.inverse(robots[0].pose[0]))
    return [np.asarray(p) for p in np.split(se2.between(origin, refined), np.cumsum(size)[:-1])]


def _ties(merge: Merge, start: np.ndarray, at_a: int, at_b: int, alike: float) -> PoseGraph:
    """The closures a merge was decided on, over the poses of all robots.

    alike: so many of them count as one measurement: their submaps overlap, and both maps are bent alike for all.
    """
    held = [c for c in merge.closures if c.accepted]
    least = min(alike, float(len(held)))
    pairs = [(at_a + c.first, at_b + c.second) for c in held]
    return PoseGraph.of(start, pairs, [c.measured for c in held], [c.information / least for c in held])
