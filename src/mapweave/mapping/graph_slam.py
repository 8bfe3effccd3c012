"""Graph mapping: scan odometry in segments, places found again, one pose graph, and a last pass over everything.

While scans come `step` drives the front end, makes keyframes, and looks for old places; `finalise` decides once more
which of the places found hold, matches all keyframes jointly and lays every scan on them. Where light tells places
apart the front end is the particle filter: its hypotheses find the trajectory along walls that say nothing, and its
best lineage makes the keyframes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Event, Scan
from ..core.rows import RowBuffer
from ..core.workers import Progress, no_progress
from ..laser import particle_slam
from ..laser.beam import STEERING, Beams, IntensityCalibration, beams
from ..laser.joint_pass import JOINT_PASS_BEAMS, SCAN_AROUND, SCAN_BEAMS, joint_pass, lay_scans, neighbours, scan_cloud
from ..laser.keyframes import Keyframe, KeyframeMaker, KeyframeOdometry, StepNoise, carried
from ..laser.particle_slam import ParticleState
from ..laser.robot_graph import RobotGraph
from ..laser.robust_graph import CONTRADICTION
from ..laser.scan_odometry import PoseEstimate, ScanInfo, blended, field_of_view, up_to
from .borders import decide_borders
from .config import LaserConfig
from .keyframe_graph import KeyframeGraph
from .known_places import KnownPlaces
from .loops import LoopFinder
from .places import PlaceIndex
from .segments import CONTRADICTED, FADED, WHEELED, Borders, border_covariance

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
    stamps t, scans their returns (`GONE` where the map does without them), sensors where the scanner stood, reckoned
    its pose as wheels tell every step, or else scans; and of particles lines what walls tell of its pose, cuts what
    parts it from the one before. keyframes, revisits: which scan each is; unneeded: the scans whose returns went in the
    last step, all of them before scan `gone`.
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
    reckoned: RowBuffer = field(default_factory=lambda: RowBuffer(3))
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
    told = state.odometry.step if state.odometry.odometry.told is None else state.odometry.odometry.told
    state.reckoned.append(se2.compose(state.reckoned[-1], told) if len(state.reckoned) else np.zeros(3))
    cut = _cut(state.borders, event.t, scan, info, state.odometry.step, leapt=leapt)
    state.unneeded = _grow(state, cfg, len(state.scans) - 1, segment_keyframe(state.odometry.maker, event.t, b, cut))
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


def segment_keyframe(maker: KeyframeMaker, t: float, b: Beams, cut: SegmentBorder) -> Keyframe | None:
    """The keyframe at the maker's latest pose, if there is one; where views faded and it slid, where wheels say."""
    keyframe = maker.keyframe(t, b, cut.why, cut.weak)
    if keyframe is None:
        return None
    if cut.off is not None:
        keyframe = keyframe._replace(step=np.asarray(se2.compose(keyframe.step, se2.inverse(cut.off))))
    if cut.why != FADED or keyframe.wheels is None:
        return keyframe
    cov = border_covariance(keyframe.wheels, FADED)
    off = se2.between(keyframe.wheels, keyframe.step)
    slid = bool(off @ np.linalg.solve(cov, off) > CONTRADICTION)  # the views before had begun to fade, too
    return keyframe._replace(step=keyframe.wheels, cov=cov) if slid else keyframe


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
        _grow(grown, cfg, row, segment_keyframe(maker, float(state.t[row]), state.scans[row], state.cuts[row]))
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
    corrected = np.concatenate([pose, robot.revisits.poses(pose)])[order]
    none = np.zeros(len(robot.revisits), dtype=bool)
    led = np.concatenate([[graph.wheels_lead_to(i) for i in range(len(rows))], none])[order]
    cut = np.concatenate([[bool(node.border) for node in graph.nodes], none])[order] & ~led
    poses = blended(local, at[order], corrected, cut)
    if led.any():
        by = up_to(at[order], led, len(poses))
        poses[by] = blended(state.reckoned.array, at[order], corrected)[by]
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
