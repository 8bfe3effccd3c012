"""One robot's map decided anew where somebody says of places what is so."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..laser.closures import Closure
from ..laser.joint_pass import JOINT_PASS_BEAMS, joint_pass, keyframe_cloud
from ..laser.laser_map import LaserMap
from ..laser.occupancy_mapper import keyframe_returns, render_returns
from ..laser.robot_graph import RobotGraph
from ..laser.robust_graph import RobustGraphConfig, solve_graph
from .config import LaserConfig
from .decisions import APART, TOGETHER, PlaceRow, keyframe_at
from .keyframe_graph import ELSEWHERE
from .woven_map import placed_track

SD, SD_TURN = 0.03, 0.01  # [m], [rad] of a pose that somebody tells of a place: as sure as scans are, or it gives way
TOLD = np.diag([SD**-2, SD**-2, SD_TURN**-2])  # information of it
CONTRADICTS = 5.0  # standard deviations from which a place contradicts the rest


class Redecided(NamedTuple):
    """findings: where somebody's word and the scans are far apart; used: each row as it was honoured."""

    map: LaserMap
    findings: tuple[Finding, ...]
    used: tuple[PlaceRow, ...]


def redecided(local_map: LaserMap, rows: Sequence[PlaceRow], cfg: LaserConfig) -> Redecided:
    """One robot's map with these places as they are said to be; the others are decided anew beside them.

    Stamps are those of keyframes. A place that is said to be there, and was not found, lies at the row's pose. One that
    was found and refused lies where scans have it, as sure in every direction as if its pose were told besides.
    """
    graph = local_map.graph
    assert graph is not None  # noqa: S101  (only maps with a graph have places)
    closures, said, used = list(graph.closures), {}, []
    number = {(c.first, c.second): k for k, c in enumerate(closures)}
    for row in rows:
        first, second = (keyframe_at(graph, t) for t in (row.stamp_a, row.stamp_b))
        if first is None or second is None:
            continue
        at = number.get((first, second))
        if at is None:
            if row.decision == TOGETHER and row.pose is not None:
                said[len(closures)] = row
                closures.append(_told(first, second, np.array(row.pose)))
                used.append(row)
            continue
        said[at] = row
        if row.decision == TOGETHER and not closures[at].accepted:
            closures[at] = replace(closures[at], information=closures[at].information + TOLD)
        alone = TOGETHER if closures[at].accepted else APART  # which other rows may have changed, and then it is said
        used.append(replace(row, found="" if alone == row.decision else alone))
    asked = [
        k
        for k, c in enumerate(closures)
        if (said[k].decision == TOGETHER if k in said else not c.reason.startswith(ELSEWHERE))
    ]
    steps = graph.steps()
    tried = replace(graph, closures=tuple(replace(closures[k], accepted=True) for k in asked)).accepted()
    trusted = [k in said for k in asked]
    joint = steps.joined(tried)
    doubtful = np.concatenate([np.zeros(steps.edges, dtype=bool), ~np.array(trusted, dtype=bool)])
    solved = solve_graph(joint, RobustGraphConfig(), doubtful=doubtful)
    dropped = {d.edge - steps.edges: d.reason for d in solved.dropped}
    decided, findings = list(closures), []
    for n, k in enumerate(asked):
        nis = float(solved.nis[steps.edges + n])
        reason = f"said to be {TOGETHER}" if k in said else dropped.get(n) or closures[k].reason
        decided[k] = replace(closures[k], accepted=n not in dropped, nis=nis, reason=reason)
        if k in said and (before := _contradiction(graph, closures[k])) > CONTRADICTS:
            told = {"a": float(graph.t[closures[k].first]), "b": float(graph.t[closures[k].second]), "sd": before}
            findings.append(Finding("decision-contradicted", graph.robot, None, told, "it is honoured"))
    for k, row in said.items():
        if row.decision == APART:
            decided[k] = replace(closures[k], accepted=False, reason=f"said to be {APART}")
    return Redecided(
        _remade(local_map, graph, tuple(decided), solved.graph.pose, solved.covariances(), cfg),
        tuple(findings),
        tuple(used),
    )


def _contradiction(graph: RobotGraph, closure: Closure) -> float:
    """How far a place lies from where the map without it has it [sd]."""
    if closure.nis is not None:
        return float(np.sqrt(closure.nis))
    e = se2.between(closure.measured, se2.between(graph.pose[closure.first], graph.pose[closure.second]))
    return float(np.sqrt(e @ closure.information @ e))


def _told(first: int, second: int, pose: Float[np.ndarray, "3"]) -> Closure:
    return Closure((0, 0), first, second, True, f"said to be {TOGETHER}", pose, TOLD, np.zeros(3), 0.0, None)


def _remade(
    local_map: LaserMap,
    graph: RobotGraph,
    closures: tuple[Closure, ...],
    pose: Float[np.ndarray, "n 3"],
    cov: Float[np.ndarray, "n 3 3"],
    cfg: LaserConfig,
) -> LaserMap:
    """The map whose keyframes are matched jointly from `pose` on; between them scans stand as they did."""
    g = cfg.graph
    there = replace(graph, pose=pose, closures=closures)
    if g.last_pass:
        pose = joint_pass(there.steps(), keyframe_cloud([there], JOINT_PASS_BEAMS), g.joint, there.accepted())
    origin = se2.compose(pose[0], se2.inverse(graph.pose[0]))
    pose = np.asarray(se2.between(origin, pose))
    cov = np.asarray(g.unsure * cov + graph.cov[0])
    track = replace(placed_track(local_map, pose, cov), frame=local_map.track.frame)
    rows = np.clip(np.searchsorted(track.t, local_map.scans.t), 0, len(track.t) - 1)
    laid = list(keyframe_returns(graph, lit=local_map.feature != "none"))
    return replace(
        local_map,
        graph=replace(graph, pose=pose, cov=cov, closures=closures),
        track=track,
        scans=replace(local_map.scans, pose=track.pose[rows]),
        grid=render_returns(laid, pose, cfg.resolution, local_map.grid.frame, graph.panes(pose)),
    )
