"""Graph mapping: scan odometry in segments, places found again, one pose graph, and a last pass over everything.

While scans come `step` drives the front end, makes keyframes, and searches for each new submap of them among all that
came before; `finalise` decides once more which of the places found hold, matches all keyframes jointly and lays every
scan on them. Where light tells places apart the front end is the particle filter: its hypotheses find the trajectory
along walls that say nothing, and its best lineage makes the keyframes.

Over a border between segments, of the places where what came after may lie, the one holds that both sides' views allow:
in a building that looks alike in several places many more places may be found at a false one than at the right one. But
there one side saw through what the other saw as walls, as between the maps of two robots.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.records import Event, Scan
from ..core.rows import RowBuffer
from ..core.workers import Progress, no_progress
from ..laser import particle_slam
from ..laser.beam import STEERING, Beams, IntensityCalibration, beams
from ..laser.closures import Matched
from ..laser.joint_pass import JOINT_PASS_BEAMS, SCAN_AROUND, SCAN_BEAMS, joint_pass, lay_scans, neighbours, scan_cloud
from ..laser.keyframes import Keyframe, KeyframeMaker, KeyframeOdometry, StepNoise, carried
from ..laser.particle_slam import ParticleState
from ..laser.place_search import Fit
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import PoseEstimate, ScanInfo, blended, field_of_view
from .config import LaserConfig
from .keyframe_graph import CARRIED, ELSEWHERE, NEAR, KeyframeGraph
from .known_places import KnownPlaces
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
from .places import PlaceIndex, PlaceMatch, PlaceSearchConfig
from .segments import CONTRADICTED, LONG, REFUSED, WHEELED, Borders, border_covariance
from .submaps import SUBMAP_AROUND, SUBMAP_EVERY, TURN_WAY, extent, make_submap, middles

# what will do of a submap in the one before it, over a border between segments: correlation of headings, likelihood,
# share of points on walls, points that hold it, another place as likely if it is not where the step over it may lead
BORDER = PlaceSearchConfig(least_heading=0.0, least_score=0.35, least_share=0.45, least_held=12.0)
LED = replace(BORDER, least_score=0.25, least_share=0.25, least_held=5.0)  # and where wheels lead over it
BORDER_SDS = 3.0  # standard deviations from where the step over it puts it, by all three coordinates together
SEARCHED = 400  # older submaps, the nearest, that one is searched for among, at most: some 2 km of way
FOUND = 24  # places of one submap, those nearest to where the estimate has it, at most


class Loop(NamedTuple):
    """Keyframe `first` as seen from keyframe `second`, which is later or of another segment."""

    first: int
    second: int
    match: PlaceMatch


@dataclass(slots=True)
class LoopFinder:
    """The submaps of one robot as its keyframes come. `offer`, `finish` and `forget` change it.

    anchors: keyframe of each submap of the index; way: [m] up to each keyframe, turning counted; segment: the keyframe
    the latest segment begins with; made: how many submaps it has so far.
    """

    index: PlaceIndex
    light: bool = False
    anchors: list[int] = field(default_factory=list)
    way: list[float] = field(default_factory=list)
    segment: int = 0
    made: int = 0

    def copy(self) -> "LoopFinder":
        """The same search, which may go on without this one's knowing."""
        return replace(self, index=self.index.copy(), anchors=list(self.anchors), way=list(self.way))

    def offer(self, graph: KeyframeGraph) -> list[Loop]:
        """The latest keyframe of `graph` has come; what is found of the submaps that are complete now."""
        i = len(graph) - 1
        node = graph.nodes[i]
        found = self.finish(graph) if node.border else []
        step = se2.between(graph.nodes[i - 1].local, node.local) if i else np.zeros(3)
        self.way.append((self.way[-1] if i else 0.0) + float(np.hypot(step[0], step[1]) + TURN_WAY * abs(step[2])))
        if node.border:
            self.segment, self.made = i, 0
        return found + self._complete(graph, self.way[i] - SUBMAP_AROUND)

    def finish(self, graph: KeyframeGraph) -> list[Loop]:
        """The segment has ended with the keyframes there are: what is found of its last submaps."""
        return self._complete(graph, np.inf)

    def _complete(self, graph: KeyframeGraph, until: float) -> list[Loop]:
        """The submaps whose middle lies up to `until` [m] of way, made and searched for."""
        if len(self.way) == self.segment or until < self.way[self.segment] + (self.made + 0.5) * SUBMAP_EVERY:
            return []
        way = np.array(self.way[self.segment :])
        found = []
        for at in middles(way)[self.made :]:
            if way[at] > until:
                break
            self.made += 1
            low, high = extent(way, at)
            first, nodes = self.segment + low, graph.nodes[self.segment + low : self.segment + high + 1]
            q = [node.beams.q for node in nodes] if self.light else None
            poses = np.array([node.local for node in nodes])
            new = make_submap(self.segment + at, first, poses, [node.beams.s for node in nodes], q)
            if new is not None:
                old = self._old(graph, new.anchor, first)
                number = self.index.add(new)
                self.anchors.append(new.anchor)
                matches = self._nearest(graph, number, self.index.search(number, old))
                if number and first == self.segment and all(m.first != number - 1 for m in matches):
                    matches += self._over_border(graph, number)
                found += [Loop(self.anchors[m.first], new.anchor, m) for m in matches]
        return found

    def _old(self, graph: KeyframeGraph, anchor: int, first: int) -> Int[np.ndarray, " k"]:
        """The submaps that one at keyframe `anchor`, which begins with keyframe `first`, is searched for among.

        Work must not grow with the way: of many those nearest by the estimate, once something holds the segment in it.
        """
        old = np.array([k for k, at in enumerate(self.anchors) if self._apart(at, first)], dtype=np.int64)
        if len(old) <= SEARCHED or not self._held(graph):
            return old
        away = np.hypot(*(graph.pose[np.array(self.anchors)[old], :2] - graph.pose[anchor, :2]).T)
        return np.sort(old[np.argsort(away, kind="stable")[:SEARCHED]])

    def _held(self, graph: KeyframeGraph) -> bool:
        """Whether the latest segment is the first one, or places hold it."""
        late = takewhile(lambda c: c.second >= self.segment, reversed(graph.closures))
        return not self.segment or any(c.accepted for c in late)

    def _nearest(self, graph: KeyframeGraph, number: int, found: list[PlaceMatch]) -> list[PlaceMatch]:
        """Of the places found of submap `number` those nearest to where the estimate has it, in their order."""
        if len(found) <= FOUND:
            return found
        anchors = graph.pose[[self.anchors[m.first] for m in found]]
        there = np.asarray(se2.compose(anchors, np.array([m.measured for m in found])))
        away = np.hypot(*(there[:, :2] - graph.pose[self.anchors[number], :2]).T)
        return [found[k] for k in np.sort(np.argsort(away, kind="stable")[:FOUND]).tolist()]

    def _over_border(self, graph: KeyframeGraph, number: int) -> list[PlaceMatch]:
        """The first submap of a segment in the one before it, where less will do if it lies where the step puts it.

        The smaller of the two is looked for in the other: of what a single scan sees most is in the submap before it.
        """
        before, new = self.anchors[number - 1], self.anchors[number]
        last, border = graph.nodes[self.segment - 1], graph.nodes[self.segment]
        ahead = se2.compose(se2.between(graph.nodes[before].local, last.local), border.step)
        step = se2.compose(ahead, se2.between(border.local, graph.nodes[new].local))
        on = se2.between(border.local, graph.nodes[new].local)
        cov, rules = carried(border.cov, on), LED if border.border in WHEELED else BORDER
        reach = BORDER_SDS * np.sqrt(np.diag(cov))
        old, own = (len(self.index.submaps[k].points) for k in (number - 1, number))
        if old <= own:
            match = self.index.lay(number, number - 1, se2.inverse(step), reach, rules)
        else:
            match = self.index.lay(number - 1, number, step, reach, rules)
            match = None if match is None else match.inverse()
        if match is None or not match.clear:
            return []
        off = se2.between(step, match.measured)
        return [match] if off @ np.linalg.solve(cov, off) <= BORDER_SDS**2 else []

    def _apart(self, anchor: int, first: int) -> bool:
        """Whether an old submap shares no way with one that begins with keyframe `first`."""
        return anchor < self.segment or self.way[first] - self.way[anchor] > SUBMAP_AROUND

    def forget(self, first: int, last: int) -> None:
        """Keyframes `first` to `last` left the graph; those after them have other numbers."""
        gone = last + 1 - first
        keep = [k for k, anchor in enumerate(self.anchors) if not first <= anchor <= last]
        self.index = self.index.select(keep)
        self.anchors = [self.anchors[k] - (gone if self.anchors[k] > last else 0) for k in keep]
        del self.way[first : last + 1]
        if self.segment >= first:
            self.segment = max(first, self.segment - gone)


# of steps along the best particle's trajectory, which light holds where walls do not
LINEAGE = StepNoise(wheels_xy=0.015, drift_xy=0.005, drift_turn=0.001)
SETTLE_XY = 0.3  # [m] that places found move the robot by, or
SETTLE_TURN = 0.1  # [rad] turn it: what holds is decided at once

_NONE = np.zeros(0)
GONE = Beams(np.zeros((0, 2)), _NONE, _NONE, np.zeros((0, 2)), _NONE, _NONE, _NONE, *2 * [np.zeros(0, np.int64)])
"""The returns of a scan that nothing needs."""


class SegmentBorder(NamedTuple):
    """What parts a scan from the one before it.

    why: as `Borders` tells, empty: nothing; weak: covariance that the step over it has besides; off: over a gap, how
    far from where wheels put the scan it was matched: a match there may be any, and what they tell is what is known.
    """

    why: str
    weak: Float[np.ndarray, "3 3"] | None
    off: Float[np.ndarray, "3"] | None


@dataclass(slots=True)
class GraphState:
    """One robot's graph as it grows; `step` changes it.

    odometry: scan odometry, or particles: the filter that finds the trajectory where light tells places apart; graph:
    the keyframes so far (of particles: none before the best lineage is known); known: what left it. Of every scan:
    stamps t, scans their returns (`GONE` where the map does without them), sensors where the scanner stood; and of
    particles lines what walls tell of its pose, cuts what parts it from the one before. keyframes, revisits: which scan
    each is; unneeded: the scans whose returns went in the last step, all of them before scan `gone`.
    """

    robot: str
    odometry: KeyframeOdometry
    particles: ParticleState | None
    graph: KeyframeGraph
    borders: Borders
    loops: LoopFinder
    known: KnownPlaces
    feature: str
    calibration: IntensityCalibration | None
    t: RowBuffer = field(default_factory=RowBuffer)
    scans: list[Beams] = field(default_factory=list)
    sensors: list[np.ndarray] = field(default_factory=list)
    lines: list[np.ndarray] = field(default_factory=list)
    cuts: list[SegmentBorder] = field(default_factory=list)
    keyframes: list[int] = field(default_factory=list)
    revisits: list[int] = field(default_factory=list)
    unneeded: range = range(0)
    gone: int = 0


class GraphEstimate(NamedTuple):
    """poses: (m, 3) at every scan and graph: the keyframes, both in the frame of the first scan."""

    poses: Float[np.ndarray, "m 3"]
    graph: RobotGraph


def init(
    robot: str,
    cfg: LaserConfig,
    rng: np.random.Generator,
    *,
    feature: str = "none",
    calibration: IntensityCalibration | None = None,
    gated: bool = False,  # noqa: ARG001  (every estimator is begun the same way)
) -> GraphState:
    """No keyframes yet; the first scan will be at the origin."""
    g = cfg.graph
    particles = None
    if g.hypotheses > 0 and feature in STEERING:
        particles = particle_slam.init(robot, _filtering(cfg), rng, feature=feature, calibration=calibration)
        particles.odometry.tell_lines = True
    return GraphState(
        robot,
        KeyframeOdometry(0, g.keyframe_graph.keyframes, cfg.front_end, feature, learn=True),
        particles,
        KeyframeGraph(g.keyframe_graph, np.zeros((1, 3))),
        Borders(),
        _search(feature),
        KnownPlaces(g.known_places),
        feature,
        calibration,
    )


def step(
    state: GraphState, event: Event, cfg: LaserConfig, rng: np.random.Generator
) -> tuple[GraphState, ScanInfo | None]:
    """Scans move the estimate and may close a loop; odometry packets give no info: a scan brings its own odometry."""
    if not isinstance(event.record, Scan):
        return state, None
    scan = event.record
    b = beams(scan, state.feature, state.calibration, cfg.beam)
    state.t.append(event.t)
    state.scans.append(b)
    mounted = np.array(scan.T_robot_sensor[:2], float)
    same = bool(state.sensors) and state.sensors[-1].tobytes() == mounted.tobytes()
    state.sensors.append(state.sensors[-1] if same else mounted)
    leapt = state.borders.leapt(event.t, scan.odometry)
    if state.particles is not None:
        state.particles, info = particle_slam.step(state.particles, event, _filtering(cfg), rng, leapt=leapt)
        assert info is not None  # noqa: S101  (of a scan)
        matched = replace(info, decision="matched") if info.decision == "skipped" else info
        state.lines.append(state.particles.odometry.lines)
        state.cuts.append(_cut(state.borders, event.t, scan, matched, state.particles.odometry.step, leapt=leapt))
        return state, info
    info = state.odometry.advance(scan, b, leapt=leapt, t=event.t)
    cut = _cut(state.borders, event.t, scan, info, state.odometry.step, leapt=leapt)
    state.unneeded = _grow(state, cfg, len(state.scans) - 1, _keyframe(state.odometry.maker, event.t, b, cut))
    for row in state.unneeded:
        state.scans[row] = GONE
    return state, info


def _cut(
    borders: Borders, t: float, scan: Scan, info: ScanInfo, step: Float[np.ndarray, "3"], *, leapt: bool
) -> SegmentBorder:
    """What parts the scan at `t` [s] from the one before it; `step` is what scan odometry has between the two."""
    wheels, wide = scan.odometry is not None and not leapt, field_of_view(scan).wide
    why = borders.seen(t, info, step, wheels=wheels, wide=wide)
    wheeled = why in WHEELED and scan.odometry is not None
    weak = border_covariance(step, why if wheeled else "") if why else None
    return SegmentBorder(why, weak, info.innovation if wheeled and info.decision == "matched" else None)


def _keyframe(maker: KeyframeMaker, t: float, b: Beams, cut: SegmentBorder) -> Keyframe | None:
    """The keyframe at the maker's latest pose, if there is one."""
    keyframe = maker.keyframe(t, b, cut.why, cut.weak)
    if keyframe is None or cut.off is None:
        return keyframe
    return keyframe._replace(step=np.asarray(se2.compose(keyframe.step, se2.inverse(cut.off))))


def current(state: GraphState) -> PoseEstimate:
    """Where the robot is after the latest scan, in the frame of the first; nothing changes."""
    if state.particles is not None:
        return particle_slam.current(state.particles)
    maker, graph = state.odometry.maker, state.graph
    if maker.last is None:
        return PoseEstimate(np.zeros(3), np.zeros((3, 3)))
    last = graph.of[0][-1]
    step = se2.between(maker.last.local, maker.local)
    pose = se2.compose(graph.pose[last], step)
    cov = graph.marginal(last)
    if (step != 0.0).any():
        seen = carried(se2.turned_covariance(-graph.pose[last, 2], cov), step) + maker.covariance()
        cov = np.asarray(se2.turned_covariance(pose[2], seen))
    return PoseEstimate(np.asarray(pose), cov + graph.jitter)


def so_far(state: GraphState, cfg: LaserConfig, *, covariances: bool = True) -> RobotGraph:
    """The keyframes so far, solved, without the last pass; `state` is as before. Without `covariances` they are NaN."""
    _, grown = _whole(state, cfg, no_progress)
    n = len(grown.keyframes)
    cov = cfg.graph.unsure * grown.graph.covariances() if covariances else np.full((n, 3, 3), np.nan)
    sensors = np.array(state.sensors).reshape(-1, 2)
    return _robot_graph(grown, grown.graph.pose, cov, sensors[grown.keyframes], cfg.graph.unsure)


def _search(feature: str) -> LoopFinder:
    """The search for loops among submaps, of which there are none yet."""
    return LoopFinder(PlaceIndex(), light=feature in STEERING)


def _filtering(cfg: LaserConfig) -> LaserConfig:
    return replace(cfg, particles=cfg.graph.hypotheses)


def _grow(state: GraphState, cfg: LaserConfig, row: int, keyframe: Keyframe | None) -> range:
    """The graph has the keyframe, made at scan `row`, if there is one, and the loops found from it.

    Where it lies in a place known well earlier keyframes may leave: then the scans are returned that none needs.
    """
    if keyframe is None:
        return range(0)
    state.keyframes.append(row)
    graph, loops = state.graph, state.loops
    number = graph.add(keyframe)
    if not cfg.graph.loops:
        return range(0)
    found = loops.offer(graph)
    for loop in found:
        graph.tie(loop.first, loop.second, loop.match)
    innovations = [graph.closures[k].innovation for k in range(-len(found), 0)]
    if found and (graph.grown or (not graph.settled and _moved(innovations))):
        graph.settle(for_now=True)
    if not found:
        return range(0)
    left = state.known.step(graph, number, lambda i, k: _laid(state, i, k))
    if left is None:
        return range(0)
    loops.forget(left.first, left.last)
    rows = state.keyframes
    unneeded = range(max(rows[left.first - 1] + 1, state.gone), rows[left.last + 1])
    state.gone = unneeded.stop
    state.revisits += rows[left.first : left.last + 1]
    del rows[left.first : left.last + 1]
    return unneeded


def _moved(innovations: Sequence[Float[np.ndarray, "3"]]) -> bool:
    """Whether the places found put the robot elsewhere than the estimate does, most of them."""
    off = np.median(np.abs(innovations), axis=0)
    return bool(max(off[0], off[1]) > SETTLE_XY or off[2] > SETTLE_TURN)


def _laid(state: GraphState, first: int, last: int) -> Float[np.ndarray, "c 3"]:
    """Keyframes `first` to `last` matched against those before them that stand around."""
    graph = state.graph
    rows, own = np.array(state.keyframes), np.arange(first, last + 1)
    pose, old = graph.pose[own], graph.pose[:first]
    near = np.unique(neighbours(pose, old, SCAN_AROUND))
    near = near[near >= 0]
    old_cloud, cloud = (
        scan_cloud([graph.nodes[k].beams for k in at], np.array([state.sensors[k] for k in rows[at]]), most)
        for at, most in ((near, JOINT_PASS_BEAMS), (own, SCAN_BEAMS))
    )
    return lay_scans(pose, cloud, old[near], old_cloud, np.full(len(own), -1, np.int64))


def _whole(state: GraphState, cfg: LaserConfig, on_progress: Progress) -> tuple[Float[np.ndarray, "m 3"], GraphState]:
    """Poses at every scan as the front end has them, and a state whose graph is solved and free to be changed."""
    if state.particles is None:
        local, grown = state.odometry.odometry.poses.array, replace(state, graph=state.graph.copy())
        loops = state.loops.copy()
    else:
        local, grown = _along_lineage(state, state.particles, cfg, on_progress)
        loops = grown.loops
    for loop in loops.finish(grown.graph) if cfg.graph.loops else ():
        grown.graph.tie(loop.first, loop.second, loop.match)
    grown.graph.settle()
    if len(grown.graph):
        grown.graph.unclear = decide_borders(grown.graph)
    return local, grown


def _along_lineage(
    state: GraphState, particles: ParticleState, cfg: LaserConfig, on_progress: Progress
) -> tuple[Float[np.ndarray, "m 3"], GraphState]:
    """Poses at every scan of the best particle's lineage, and the graph grown along them."""
    poses = particle_slam.trajectory(particles)
    grown = replace(
        state,
        graph=KeyframeGraph(cfg.graph.keyframe_graph, np.zeros((1, 3))),
        loops=_search(state.feature),
        known=KnownPlaces(cfg.graph.known_places),
        keyframes=[],
        revisits=[],
    )
    maker = KeyframeMaker(0, replace(cfg.graph.keyframe_graph.keyframes, noise=LINEAGE))
    before = poses[0]
    for row, pose in enumerate(poses):
        maker.advance(pose, se2.between(before, pose), state.lines[row])
        before = pose
        _grow(grown, cfg, row, _keyframe(maker, float(state.t[row]), state.scans[row], state.cuts[row]))
        on_progress("loops", row + 1, len(poses))
    return poses, grown


def finalise(state: GraphState, cfg: LaserConfig, on_progress: Progress = no_progress) -> GraphEstimate:
    """The whole estimate of all scans so far. `state` is as before: further scans may come."""
    joint = cfg.graph.joint
    local, grown = _whole(state, cfg, on_progress)
    graph = grown.graph
    cov = cfg.graph.unsure * graph.covariances()
    sensors = np.array(state.sensors).reshape(-1, 2)
    rows = np.array(grown.keyframes, dtype=np.int64)
    steps, closed = graph.edges()
    pose = graph.pose
    if cfg.graph.last_pass:
        on_progress("last pass", 0, 2)
        cloud = scan_cloud([state.scans[k] for k in rows], sensors[rows], JOINT_PASS_BEAMS)
        pose = joint_pass(steps, cloud, joint, closed)
        on_progress("last pass", 1, 2)
    robot = _robot_graph(grown, pose, cov, sensors[rows], cfg.graph.unsure)
    at = np.concatenate([rows, np.array(grown.revisits, np.int64)])
    order = np.argsort(at, kind="stable")
    cut = np.array([bool(node.border) for node in graph.nodes] + [False] * len(robot.revisits))
    poses = blended(local, at[order], np.concatenate([pose, robot.revisits.poses(pose)])[order], cut[order])
    if cfg.graph.last_pass:
        own = np.full(len(local), -1, np.int64)
        own[rows] = np.arange(len(rows))
        there = np.flatnonzero([scan is not GONE for scan in state.scans])
        scans = scan_cloud([state.scans[k] for k in there], sensors[there], SCAN_BEAMS)
        poses[there] = lay_scans(poses[there], scans, pose, cloud, own[there])
        on_progress("last pass", 2, 2)
    return GraphEstimate(poses, robot)


def _robot_graph(
    state: GraphState,
    pose: Float[np.ndarray, "n 3"],
    cov: Float[np.ndarray, "n 3 3"],
    sensors: Float[np.ndarray, "n 2"],
    unsure: float,
) -> RobotGraph:
    nodes, revisits = state.graph.nodes, state.known.revisits
    steps, _ = state.graph.edges()
    start = np.concatenate([[0], np.cumsum([len(node.beams.q) for node in nodes])])
    return RobotGraph(
        robot=state.robot,
        t=np.array([node.t for node in nodes]),
        pose=pose,
        cov=cov,
        path=state.graph.path,
        step=steps.measured,
        step_information=steps.information,
        border=tuple(
            node.border or (CONTRADICTED if i in state.graph.contradicted else "") for i, node in enumerate(nodes)
        ),
        closures=tuple(state.graph.closures),
        unclear=state.graph.unclear,
        start=start,
        points=np.concatenate([node.beams.s for node in nodes]),
        normals=np.concatenate([node.beams.normal for node in nodes]),
        q=None if state.feature == "none" else np.concatenate([node.beams.q for node in nodes]),
        lined=np.concatenate([node.beams.support for node in nodes]) >= 3,
        sensor=sensors,
        feature=state.feature,
        calibration=state.calibration,
        revisits=replace(revisits, cov=unsure * revisits.cov),
    )


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
