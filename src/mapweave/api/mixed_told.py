"""What is told of a mixed team: what each robot carries, warnings, and `metrics.json`."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..core.findings import Finding, Unused, of_robot, verdict
from ..core.landmark_log import LandmarkLog
from ..core.names import robot_key
from ..core.version import __version__
from ..fusion.result import Fusion
from ..io.team_map import told_gaps
from ..landmarks.landmark_map import LocalMap
from ..laser.laser_map import LaserMap
from ..report.html import told_list
from ..team.mixed import MixedMap
from ..team.walls import Scanned


def carries(log: LandmarkLog, scanned: Mapping[str, Scanned]) -> str:
    """What a robot's logs hold, in words."""
    things = ["laser"] if log.robot in scanned else []
    if log.odometry is not None:
        things.append("wheels")
    if len(log.sightings):
        things.append("camera")
    if len(log.bearings):
        things.append("bearings")
    return ", ".join(things) or "nothing"


def findings_of(
    read: Sequence[LandmarkLog],
    lasers: Mapping[str, LaserMap],
    fusion: Fusion | None,
    mixed: MixedMap,
    apart: Mapping[str, float],
) -> tuple[Finding, ...]:
    out = [] if fusion is None else list(fusion.findings)
    for log in read:
        idle = log.robot in lasers
        out += of_robot([f for f in log.findings if not (idle and f.code == "saw-nothing")], log.robot)
    out += [found for robot, m in lasers.items() for found in of_robot(m.findings, robot)]
    out += [Finding("clock-apart", robot, value=gap, action="it stays apart") for robot, gap in apart.items()]
    own = {log.robot: len(log.sightings) + len(log.bearings) for log in read}
    for robot in mixed.layout.lost:
        why = "nothing that it saw, and nobody who saw it, tells where it was"
        if own.get(robot):
            why = f"its {own[robot]} sightings and those of it place it at too few moments to tell where it was"
        out.append(Finding("unplaced", robot, value=why))
    if others := [robot for component in mixed.components[1:] for robot in component.map.robots]:
        out.append(Finding("robots-apart", value=told_list(others)))
    for component in mixed.components:
        out += component.findings
    return tuple(out)


def robot_metrics(
    log: LandmarkLog, local: LocalMap | None, laser: LaserMap | None, findings: Sequence[Finding]
) -> dict[str, Any]:
    """What `metrics.json` tells of every robot, whatever it carries.

    sightings: of landmarks and robots, or the scans of a robot that has a laser alone; local: its own landmark map.
    """
    seen, scans = len(log.sightings) + len(log.bearings), 0 if laser is None else len(laser.scans)
    odometry = "none" if laser is None else laser.odometry
    mine = [found for found in findings if found.robot == robot_key(log.robot)]
    return {
        "source": log.source,
        "verdict": verdict(mine),
        "odometry": odometry if log.odometry is None else "velocity",
        "sightings": seen or scans,
        "scans": scans,
        "dropped": {**({} if laser is None else laser.dropped), **(log.dropped if local is None else local.dropped)},
        "down_weighted": 0 if local is None else local.down_weighted,
        "nis_median": None if local is None else local.nis_median,
        "warnings": [found.text for found in mine],
    }


def mixed_metrics(
    mixed: MixedMap,
    kinds: Mapping[str, str],
    robots: Mapping[str, Mapping[str, Any]],
    findings: Sequence[Finding],
    unused: Sequence[Unused],
    seed: int,
) -> dict[str, Any]:
    """`robots`: of each, what `robot_metrics` tells."""
    return {
        "version": __version__,
        "seed": seed,
        "verdict": verdict(findings),
        "findings": [found.row() for found in findings],
        "unused": [left.row() for left in unused],
        "robots": {
            robot_key(r): {
                **robots[r],
                "carries": kind,
                "clock": {"ahead": mixed.clocks[r].ahead, "sd": mixed.clocks[r].sd} if r in mixed.clocks else None,
            }
            for r, kind in kinds.items()
        },
        "components": [[robot_key(r) for r in s.map.robots] for s in mixed.components],
        "lost": [robot_key(r) for r in mixed.layout.lost],
        "ties": [
            {
                "a": [robot_key(r) for r in tie.a],
                "b": [robot_key(r) for r in tie.b],
                "agree": tie.agree,
                "of": tie.of,
                "by": tie.by,
                "clock": tie.clock,
            }
            for tie in mixed.layout.ties
        ],
        "through": [
            {
                "robots": [robot_key(r) for r in path.robots],
                "sightings": list(path.sightings),
                "landmarks": list(path.landmarks),
            }
            for path in mixed.paths
        ],
        "refined": [
            {
                "status": s.status,
                "iterations": s.iterations,
                "poses": s.poses,
                "factors": dict(s.used),
                "refused": s.refused or None,
            }
            for s in mixed.components
        ],
        "left_out": told_gaps([s.map for s in mixed.components]),
        "fusion": [merge.row() for merge in mixed.merges],
        "warnings": [found.told for found in findings],
    }
