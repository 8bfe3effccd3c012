"""The estimate of a laser robot that drives on and on: what is needed to go on and to draw its map, and no more."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.records import Event
from ..laser.beam import Beams
from ..laser.config import LaserConfig
from ..laser.graph_slam import GraphState
from ..laser.keyframe_graph import KeyframeGraph
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import ScanInfo
from ..laser.session import LaserSession

NO_POINTS = np.zeros((0, 2))


class DrivenSession(LaserSession):
    """The estimate of `map --method graph` by geometry, of which only keyframes keep their returns.

    It is the same estimate scan by scan, but that no keyframe ever leaves the graph: others, who weave and draw them,
    know keyframes by their numbers. What it does not serve for is `finalise`, which lays every scan.
    """

    def __init__(self, robot: str, cfg: LaserConfig, seed: int = 0) -> None:
        staying = replace(cfg.graph, known_places=replace(cfg.graph.known_places, enough=0))
        super().__init__(robot, replace(cfg, graph=staying), seed)
        self._kept = 0  # scans before this one are let go, but for keyframes
        self._lean = 0  # keyframes before this one hold no more of their returns than is asked for

    def push(self, event: Event) -> ScanInfo | None:
        """As ever; what earlier scans brought and nothing asks for any more is let go."""
        info = super().push(event)
        state = self._state()
        if info is None or not isinstance(state, GraphState):
            return info
        self.scans.clear()
        self.infos.clear()
        newest = len(state.scans) - 1
        for k in range(self._kept, newest):
            state.scans[k] = NOTHING
        self._kept = newest
        nodes = state.graph.nodes
        while self._lean < len(nodes) - 1:
            nodes[self._lean] = nodes[self._lean]._replace(beams=_lean(nodes[self._lean].beams))
            self._lean += 1
        return info

    @property
    def keyframes(self) -> KeyframeGraph | None:
        """The keyframes so far, as they were solved last; None before the first scan."""
        state = self._state()
        return state.graph if isinstance(state, GraphState) and len(state.graph) else None

    def bare_graph(self, name: str) -> RobotGraph | None:
        """The keyframes as they were solved last, with steps and closures, without returns and covariances (NaN)."""
        graph = self.keyframes
        if graph is None:
            return None
        n = len(graph)
        steps, _ = graph.edges()
        return RobotGraph(
            robot=name,
            t=np.array([node.t for node in graph.nodes]),
            pose=graph.pose,
            cov=np.full((n, 3, 3), np.nan),
            path=graph.path,
            step=steps.measured,
            step_information=steps.information,
            closures=tuple(graph.closures),
            start=np.zeros(n + 1, dtype=np.int64),
            points=NO_POINTS,
            normals=NO_POINTS,
            q=None,
            lined=np.zeros(0, dtype=bool),
            sensor=np.zeros((n, 2)),
        )

    def sensor(self, keyframe: int) -> Float[np.ndarray, "2"]:
        """Where the scanner stood on the robot [m] at a keyframe."""
        state = self._state()
        assert isinstance(state, GraphState)  # noqa: S101  (there is a keyframe)
        return np.asarray(state.sensors[state.keyframes[keyframe]])


def _nothing() -> Beams:
    none, pairs = np.zeros(0), NO_POINTS
    whole = np.zeros(0, dtype=np.int64)
    return Beams(pairs, none, none, pairs, none, none, none, whole, whole)


def _lean(b: Beams) -> Beams:
    """Where the returns are and what line they make; geometry asks for no more of an earlier keyframe."""
    still = np.broadcast_to(0.0, len(b.q))
    return NOTHING._replace(s=b.s, normal=b.normal, support=b.support, q=still)


NOTHING = _nothing()  # returns of a scan that nothing asks for any more
