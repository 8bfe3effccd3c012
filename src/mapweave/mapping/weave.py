"""The maps of many robots woven into one: pairs merged or refused, components, one pose graph over all robots."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.errors import DataError
from ..laser.joint_pass import JOINT_PASS_BEAMS, JointPassConfig, joint_pass, keyframe_cloud
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from ..laser.robust_graph import RobustGraphConfig, SolvedGraph, connected, solve_graph
from .decisions import APART, TOGETHER, Decisions, PairRow, keyframe_at
from .map_overlap import KeyframeMap, keyframe_map
from .merge import NUDGE, NUDGE_TURN, Merge, merge_as_said, merge_maps
from .merge_search import MergeConfig, Start, start_between
from .segments import pieces_of

TIES_ALIKE = 12.0  # submaps that confirm count as one measurement, since their errors are alike


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


def weave(
    robots: Sequence[RobotGraph],
    cfg: MergeConfig | None = None,
    starts: Mapping[int, Start] | None = None,
    *,
    merge: bool = True,
    last: JointPassConfig | None = None,
    known: Mapping[tuple[int, int], Merge] | None = None,
    executor: Executor | None = None,
    said: Decisions | None = None,
) -> Woven:
    """One map of all robots that can be tied together, each in its place; the others on their own.

    What is laid on what is each robot's pieces, so that one of them may join two that nothing else ties. starts: by
    place in `robots`, where a robot's frame is said to lie in that of the first. merge: False leaves every robot alone.
    Pieces are tried against those of the robots before; one that is tied in already is not tried again with a piece it
    is tied to, and a tie that the joint graph drops is no tie.

    last: how all keyframes of a component are matched in the end. known: what was decided earlier on pairs of these
    robots, when there was less of them: taken as it stands, its closures by their keyframes. executor: where pairs are
    tried side by side, those too that are not needed then: what comes of it is the same. said: what somebody says of
    pairs of robots, and of places that tie them, which is honoured whatever the scans say; raises DataError where two
    are said to be together and nobody, nor their scans, tells where.
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
    tried = _Trials(robots, pieces, cfg, starts or {}, known, executor if merge else None)
    many = range(len(robots) if merge else 0)
    for i, j in sorted(combinations(many, 2), key=lambda pair: (pair[1], pair[0])):
        decided = _decided((i, j), robots, of, frames, tried, known, said)
        for decision in decided:
            if decision.transform is not None:
                graph = graph.joined(_ties(decision, start, int(offset[i]), int(offset[j]), TIES_ALIKE))
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


def _decided(
    pair: tuple[int, int],
    robots: Sequence[RobotGraph],
    of: Sequence[Sequence[int]],
    frames: "_Frames",
    tried: "_Trials",
    known: Mapping[tuple[int, int], Merge],
    said: Decisions | None,
) -> list[Merge]:
    """What is decided on a pair of robots, piece by piece; `frames` holds what that ties. of: each robot's pieces."""
    i, j = pair
    word = None if said is None else said.pair(robots[i].robot, robots[j].robot)
    first = of[i][0], of[j][0]
    if word is not None and word.decision == APART:
        return [_apart(tried(*first))]
    if pair in known:
        merge = known[pair]
        p, q = (tried.holding(of[k], merge, end) for k, end in ((i, "first"), (j, "second")))
        if frames.group[p] == frames.group[q]:
            return []
        if merge.transform is not None:
            frames.tie(p, q, merge.transform)
        return [merge]
    decided = []
    for p, q in product(of[i], of[j]):
        if frames.group[p] == frames.group[q]:
            continue
        merge = tried(p, q)
        if said is not None:
            merge = _with_ties(merge, robots[i], robots[j], said)
        if word is not None and (p, q) == first and _elsewhere(merge, word):
            merge = tried.as_said(p, q, word, merge)
        decided.append(merge)
        if merge.transform is not None:
            frames.tie(p, q, merge.transform)
    return decided


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


def _as_one(decided: Sequence[Merge]) -> Merge:
    """What was decided on the pieces of two robots: that on those which most ties hold, with the closures of all."""
    if len(decided) == 1:
        return decided[0]
    best = max(decided, key=lambda m: (m.merged, m.agreeing if m.merged else 0))
    merged = [m for m in decided if m.merged]
    others = [m for m in decided if m is not best]
    closures = [*best.closures, *(replace(c, accepted=c.accepted and m.merged) for m in others for c in m.closures)]
    reason = best.reason if len(merged) < 2 else f"{best.reason}; {len(merged)} pieces of them are tied"
    return replace(best, reason=reason, closures=tuple(closures))


class _Trials:
    """What is decided on pieces p and q of robots i < j, with an executor on all at once, else when it is asked for.

    A start tells where the piece lies that its robot began with.
    """

    def __init__(
        self,
        robots: Sequence[RobotGraph],
        pieces: Sequence[Piece],
        cfg: MergeConfig,
        starts: Mapping[int, Start],
        known: Mapping[tuple[int, int], Merge],
        executor: Executor | None,
    ) -> None:
        self.pieces, self.cfg, self.starts = pieces, cfg, starts
        self.robots, self._maps = robots, dict[int, KeyframeMap]()
        self.running = {
            (p, q): executor.submit(merge_maps, self.map(p), self.map(q), cfg, self._start(p, q))
            for p, q in combinations(range(len(pieces)), 2)
            if executor is not None
            and pieces[p].robot != pieces[q].robot
            and (pieces[p].robot, pieces[q].robot) not in known
        }

    def map(self, p: int) -> KeyframeMap:
        """Of piece p, made when it is asked for first."""
        if p not in self._maps:
            self._maps[p] = keyframe_map(self.robots[self.pieces[p].robot], self.pieces[p].rows)
        return self._maps[p]

    def __call__(self, p: int, q: int) -> Merge:
        there = self.running.get((p, q))
        made = there.result() if there else merge_maps(self.map(p), self.map(q), self.cfg, self._start(p, q))
        return self._numbered(p, q, made)

    def holding(self, own: Sequence[int], merge: Merge, end: str) -> int:
        """Of a robot's `own` pieces the one that most accepted closures of a merge end in."""
        if len(own) == 1 or not merge.closures:
            return own[0]
        ends = np.array([getattr(c, end) for c in merge.closures if c.accepted], dtype=np.int64)
        return max(own, key=lambda p: int(np.isin(ends, self.pieces[p].rows).sum()))

    def as_said(self, p: int, q: int, row: PairRow, scans: Merge) -> Merge:
        """The two pieces together, as `row` says; where it tells no pose, where they fit best by their `scans`."""
        pose = scans.best if row.pose is None else np.array(row.pose)
        if pose is None:
            raise DataError(
                f"robots {row.a} and {row.b} are said to be {TOGETHER}, and no place of one is found in the other: "
                "expected the pose of the second in the first's map"
            )
        return self._numbered(p, q, merge_as_said(self.map(p), self.map(q), pose))

    def _start(self, p: int, q: int) -> Start | None:
        first = not self.pieces[p].rows[0] and not self.pieces[q].rows[0]
        return start_between(self.starts, self.pieces[p].robot, self.pieces[q].robot) if first else None

    def _numbered(self, p: int, q: int, merge: Merge) -> Merge:
        rows = self.pieces[p].rows, self.pieces[q].rows
        closures = [replace(c, first=int(rows[0][c.first]), second=int(rows[1][c.second])) for c in merge.closures]
        return replace(merge, closures=tuple(closures))


def _elsewhere(scans: Merge, row: PairRow) -> bool:
    """Whether two maps that are said to be together are not, by their `scans`, or lie elsewhere than is said."""
    if scans.transform is None or row.pose is None:
        return scans.transform is None
    away = se2.between(np.array(row.pose), scans.transform)
    return bool(np.hypot(away[0], away[1]) > NUDGE or abs(away[2]) > NUDGE_TURN)


def _apart(scans: Merge) -> Merge:
    """Two maps that somebody says are not one, whatever their `scans` say."""
    closures = tuple(replace(c, accepted=False) for c in scans.closures)
    reason = f"said to be {APART}; by their scans: {scans.reason}"
    return replace(
        scans,
        merged=False,
        transform=None,
        covariance=None,
        reason=reason,
        closures=closures,
        said=APART,
        scans=scans.merged,
    )


def _with_ties(merge: Merge, a: RobotGraph, b: RobotGraph, said: Decisions) -> Merge:
    """The decision with the ties that somebody says hold, or do not."""
    words = {}
    for row in said.between(a.robot, b.robot):
        stamps = (row.stamp_a, row.stamp_b) if row.robot_a == a.robot else (row.stamp_b, row.stamp_a)
        words[keyframe_at(a, stamps[0]), keyframe_at(b, stamps[1])] = row.decision
    if not words:
        return merge
    closures = [
        c
        if (word := words.get((c.first, c.second))) is None
        else replace(c, accepted=word == TOGETHER, reason=f"said to be {word}")
        for c in merge.closures
    ]
    return replace(merge, closures=tuple(closures))


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
    refined = joint_pass(steps, keyframe_cloud(robots, JOINT_PASS_BEAMS), cfg, ties, owner)
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
