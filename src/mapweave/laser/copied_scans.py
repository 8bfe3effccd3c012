"""Robots whose logs are copies of one drive, with other stamps or other scans left out: noise never comes twice."""

from collections.abc import Sequence
from itertools import combinations

from ..core.config import config
from ..core.names import robot_name
from .robot_graph import RobotGraph


@config
class CopyCheck:
    """When two logs are taken for copies of one drive."""

    least_returns: int = 30  # of a keyframe that is compared,
    scans: int = 5  # that are equal, at least, and
    share: float = 0.05  # of the keyframes of the robot that has fewer


def copies_told(graphs: Sequence[RobotGraph], cfg: CopyCheck) -> list[str]:
    """A warning for each pair of robots of which keyframes have the same returns, to the last digit."""
    seen = [_keyframes(graph, cfg) for graph in graphs]
    out = []
    for a, b in combinations(range(len(graphs)), 2):
        equal, fewer = len(seen[a] & seen[b]), min(len(seen[a]), len(seen[b]))
        if equal >= max(cfg.scans, cfg.share * fewer):
            names = f"{robot_name(graphs[a].robot)} and {robot_name(graphs[b].robot)}"
            out.append(
                f"{names} hold the same scans at {equal} of {fewer} keyframes: their logs seem to be copies of one "
                "drive, which counts twice, and the map is surer than it should be"
            )
    return out


def _keyframes(graph: RobotGraph, cfg: CopyCheck) -> set[bytes]:
    """The returns of each keyframe, each told from all others."""
    pairs = zip(graph.start[:-1].tolist(), graph.start[1:].tolist(), strict=True)
    return {graph.points[i:j].tobytes() for i, j in pairs if j - i >= cfg.least_returns}
