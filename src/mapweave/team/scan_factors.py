"""What laser scans say of a team's poses: each robot's own pose graph, and keyframes of different robots matched."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..laser.pose_graph import PoseGraph, edge_factor
from ..laser.robot_graph import RobotGraph
from ..solve import Cauchy, Factor
from .robot_part import RobotPart


@dataclass(frozen=True, slots=True)
class InterRobotEdge:
    """Keyframe `second` of robot `b` at `measured` (3,) as seen from keyframe `first` of robot `a`.

    information: (3, 3) in the later one's frame.
    """

    a: str
    b: str
    first: int
    second: int
    measured: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]


def scan_factor(part: RobotPart, graph: RobotGraph) -> Factor:
    """Steps and closures between a robot's keyframes, with the relative poses of its finished map.

    The last pass over all scans knows these relative poses better than the matches they began with; so its map is the
    minimum of this factor, and the information of the pose graph says how firmly.
    """
    edges = graph.graph()
    ways = se2.between(graph.pose[edges.first], graph.pose[edges.second])
    return _edges(PoseGraph(graph.pose, edges.first, edges.second, np.asarray(ways), edges.information), part, part)


def inter_robot_factor(a: RobotPart, b: RobotPart, crossings: list[InterRobotEdge], outlier: float) -> Factor:
    """Keyframes of two robots that were matched."""
    pairs = [(c.first, c.second) for c in crossings]
    n = 1 + max(max(pair) for pair in pairs)
    graph = PoseGraph.of(np.zeros((n, 3)), pairs, [c.measured for c in crossings], [c.information for c in crossings])
    return _edges(graph, a, b, Cauchy(outlier))


def _edges(graph: PoseGraph, a: RobotPart, b: RobotPart, kernel: Cauchy | None = None) -> Factor:
    """The edges of `graph` between the poses of `a` and those of `b`."""
    m = graph.edges
    pairs = PoseGraph(np.zeros((2 * m, 3)), 2 * np.arange(m), 2 * np.arange(m) + 1, graph.measured, graph.information)
    plain = edge_factor(pairs, "scan" if a is b else "crossing", kernel)
    columns = np.concatenate([a.pose_columns(graph.first), b.pose_columns(graph.second)], axis=1)

    def residual(x: Float[np.ndarray, " n"]) -> np.ndarray:
        return plain.residual(x[columns].ravel())

    def jacobian(x: Float[np.ndarray, " n"]) -> np.ndarray:
        return plain.jacobian(x[columns].ravel())

    return Factor(columns, residual, jacobian, 3, plain.sqrt_info, kernel, plain.name)
