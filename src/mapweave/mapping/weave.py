"""The maps of many robots woven into one: pairs merged or refused, components, one pose graph over all robots."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class Woven:
    """What became of M robots' maps.

    merges: every pair tried, in order; component: (M,) which robots are connected, 0 that of the first robot; pose: of
    each robot's keyframes (n, 3) in the frame of its component, which is that of its lowest robot, after the last
    pass over all of them together; of a robot alone: its own. joint: the pose graph over all robots, keyframes in the
    robots' order, and what was dropped from it.
    """

    merges: tuple[Merge, ...]
    component: Int[np.ndarray, " M"]
    pose: tuple[Float[np.ndarray, "_ 3"], ...]
    joint: SolvedGraph


def keyframe_map(graph: RobotGraph, cfg: OverlapConfig = OVERLAP) -> KeyframeMap:
    """The keyframes of one robot as merging wants them."""
    rows = [graph.rows(i) for i in range(len(graph))]
    q = None if graph.q is None else [graph.q[r] for r in rows]
    return KeyframeMap(graph.robot, graph.pose, [graph.points[r] for r in rows], q, cfg, graph.border)


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

    starts: by place in `robots`, where a robot's frame is said to lie in that of the first. merge: False leaves every
    robot alone. Robots are tried against those before them; one that is tied in already is not tried again with a
    robot of its own component, and a tie that the joint graph drops is no tie.

    last: how all keyframes of a component are matched in the end. known: what was decided earlier on pairs of these
    robots, when there was less of them: taken as it stands, its closures by their keyframes. executor: where pairs are
    tried side by side, those too that are not needed then: what comes of it is the same.
    """
    maps = [keyframe_map(r, cfg.overlap if cfg else OVERLAP) for r in robots]
    offset = np.concatenate([[0], np.cumsum([len(r) for r in robots])])
    start = np.concatenate([r.pose for r in robots])
    graph = _side_by_side([r.graph() for r in robots], start)
    within = graph.edges
    merges: list[Merge] = []
    frame, group = [np.zeros(3) for _ in robots], list(range(len(robots)))
    tried = _tried(maps, cfg, starts or {}, known or {}, executor if merge else None)
    for j in range(1, len(robots)) if merge else ():
        for i in range(j):
            if group[i] == group[j]:
                continue
            decision = tried(i, j)
            merges.append(decision)
            if decision.transform is None:
                continue
            graph = graph.joined(
                _ties(decision, start, int(offset[i]), int(offset[j]), (cfg or MergeConfig()).ties_alike)
            )
            shift = se2.compose(se2.compose(frame[i], decision.transform), se2.inverse(frame[j]))
            old, new = max(group[i], group[j]), min(group[i], group[j])
            if group[i] != new:  # robot i's component is the one that moves
                shift = se2.inverse(shift)
            for k, g in enumerate(group):
                if g == old:
                    frame[k], group[k] = se2.compose(shift, frame[k]), new
    placed = np.concatenate([se2.compose(f, r.pose) for f, r in zip(frame, robots, strict=True)])
    graph = PoseGraph(placed, graph.first, graph.second, graph.measured, graph.information)
    doubtful = np.arange(graph.edges) >= within
    joint = solve_graph(graph, RobustGraphConfig(method="cauchy"), doubtful=doubtful)
    return _placed(robots, joint, within, tuple(merges), last or JointPassConfig())


def _tried(
    maps: Sequence[KeyframeMap],
    cfg: MergeConfig | None,
    starts: Mapping[int, Start],
    known: Mapping[tuple[int, int], Merge],
    executor: Executor | None,
) -> Callable[[int, int], Merge]:
    """What is decided on robots i < j. With an executor all pairs begin at once, else each when it is asked for."""
    if executor is None:
        return lambda i, j: known.get((i, j)) or merge_maps(maps[i], maps[j], cfg, start_between(starts, i, j))
    running = {
        (i, j): executor.submit(merge_maps, maps[i], maps[j], cfg, start_between(starts, i, j))
        for j in range(1, len(maps))
        for i in range(j)
        if (i, j) not in known
    }

    def result(i: int, j: int) -> Merge:
        return known.get((i, j)) or running[i, j].result()

    return result


def _side_by_side(graphs: Sequence[PoseGraph], pose: Float[np.ndarray, "n 3"]) -> PoseGraph:
    """The edges of graphs whose poses stand in `pose` one after the other."""
    out, at = PoseGraph.of(pose, [], [], []), 0
    for g in graphs:
        out = out.joined(PoseGraph(pose, g.first + at, g.second + at, g.measured, g.information))
        at += len(g)
    return out


def _placed(
    robots: Sequence[RobotGraph], joint: SolvedGraph, within: int, merges: tuple[Merge, ...], last: JointPassConfig
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
    return Woven(merges, component, tuple(pose), joint)


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
