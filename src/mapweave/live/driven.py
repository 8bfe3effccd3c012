"""The estimate of a laser robot that drives on and on: what is needed to go on and to draw its map, and no more.

It is the estimator of `map --method graph`, one message at a time.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.records import Event, Scan
from ..laser.beam import Beams
from ..laser.keyframes import Keyframe
from ..laser.laser_map import GridMap
from ..laser.occupancy_mapper import render_keyframes
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import ScanInfo
from ..mapping.config import LaserConfig
from ..mapping.graph_slam import GraphState
from ..mapping.keyframe_graph import KeyframeGraph
from ..mapping.session import LaserSession
from .laser_stream import LaserRecord
from .messages import TRIANGLE, Header, Numbered, Snapshot

NO_POINTS = np.zeros((0, 2))
FOLLOWED_STEP = 0.15  # [m] of odometry from a scan that is followed to the next of the same scanner: half a keyframe's
FOLLOWED_TURN = 0.15  # [rad] of it, the same
FOLLOWED_EVERY = 0.5  # [s] from one to the next, however little a robot moves
HURRIED = 3.0  # times these while messages wait


class Seen(NamedTuple):
    """points: (n, 2) returns and sensor: (2,) where they were seen from [m], in the robot's frame."""

    points: Float[np.ndarray, "n 2"]
    sensor: Float[np.ndarray, "2"]


class DrivenSession(LaserSession):
    """The estimate of `map --method graph` by geometry, of which only keyframes keep their returns.

    It is the same estimate scan by scan, of those scans that show something new: where odometry tells of less than
    `FOLLOWED_STEP` and `FOLLOWED_TURN` since the last one, within `FOLLOWED_EVERY`, a scan is passed over. What it does
    not serve for is `finalise`, which lays every scan. Keyframes are
    known to others by the number of their scan, which never changes, while in places known well they leave the graph
    and the later ones move up. left: what those saw that left since `left` was emptied last. hurried: whether more
    scans are passed over, since more come than can be followed.
    """

    def __init__(self, robot: str, cfg: LaserConfig, seed: int = 0) -> None:
        super().__init__(robot, cfg, seed)
        self.left: dict[int, Seen] = {}
        self.hurried = False
        self._followed: dict[bytes, tuple[float, np.ndarray]] = {}  # by the scanner's place: stamp [s], odometry
        self._kept = 0  # scans before this one are let go, but for keyframes

    def push(self, event: Event) -> ScanInfo | None:
        """As ever, None of a scan that is passed over; what earlier scans brought and nothing asks for is let go."""
        if isinstance(event.record, Scan) and not self._follows(event.t, event.record):
            return None
        before = self._state()
        nodes, gone = ([], 0) if before is None else (before.graph.nodes, len(before.revisits))
        info = super().push(event)
        state = self._state()
        if info is None or not isinstance(state, GraphState):
            return info
        self._note_left(state, nodes, state.revisits[gone:])
        self.scans.clear()
        self.infos.clear()
        state.t.keep_last()
        state.odometry.odometry.poses.keep_last()
        newest = len(state.scans) - 1
        for k in range(self._kept, newest):
            state.scans[k] = NOTHING
        self._kept = newest
        nodes = state.graph.nodes
        for k in range(len(nodes) - 2, -1, -1):
            if nodes[k].beams.w is NOTHING.w:
                break
            nodes[k] = nodes[k]._replace(beams=_lean(nodes[k].beams))
        return info

    def _follows(self, t: float, scan: Scan) -> bool:
        """Whether the robot has moved, or time has passed, since the last scan of this scanner that was followed."""
        if scan.odometry is None:
            return True
        where = scan.T_robot_sensor.tobytes()
        if where in self._followed:
            before, odometry = self._followed[where]
            moved = se2.between(odometry, scan.odometry)
            more = HURRIED if self.hurried else 1.0
            near = np.hypot(*moved[:2]) < more * FOLLOWED_STEP and abs(float(moved[2])) < more * FOLLOWED_TURN
            if near and t < before + more * FOLLOWED_EVERY:
                return False
        self._followed[where] = t, np.array(scan.odometry)
        return True

    @property
    def unneeded(self) -> range:
        """None: scans are not kept here."""
        return range(0)

    @property
    def keyframes(self) -> KeyframeGraph | None:
        """The keyframes so far, as they were solved last; None before the first scan."""
        state = self._state()
        return state.graph if isinstance(state, GraphState) and len(state.graph) else None

    @property
    def ids(self) -> Int[np.ndarray, " n"]:
        """Of each keyframe the number of its scan, which no other ever has; they grow."""
        state = self._state()
        return np.array(state.keyframes if isinstance(state, GraphState) else [], np.int64)

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

    def seen(self, keyframe: int) -> Seen:
        """What the keyframe of this scan saw; raises KeyError when there is none in the graph nor in `left`."""
        if keyframe in self.left:
            return self.left[keyframe]
        state = self._state()
        rows = state.keyframes if isinstance(state, GraphState) else []
        k = bisect_left(rows, keyframe)
        if not isinstance(state, GraphState) or rows[k : k + 1] != [keyframe]:
            raise KeyError(keyframe)
        return Seen(state.graph.nodes[k].beams.s, state.sensors[keyframe])

    def _note_left(self, state: GraphState, nodes: Sequence[Keyframe], rows: Sequence[int]) -> None:
        """Keyframes of scans `rows`, which stood in `nodes` one after the other, are in the graph no more."""
        first = bisect_left(state.keyframes, rows[0]) if rows else 0
        for row, node in zip(rows, nodes[first:], strict=False):
            self.left[row] = Seen(node.beams.s, state.sensors[row])


def _nothing() -> Beams:
    none, pairs = np.zeros(0), NO_POINTS
    whole = np.zeros(0, dtype=np.int64)
    return Beams(pairs, none, none, pairs, none, none, none, whole, whole)


def _lean(b: Beams) -> Beams:
    """Where the returns are and what line they make; geometry asks for no more of an earlier keyframe."""
    still = np.broadcast_to(0.0, len(b.q))
    return NOTHING._replace(s=b.s, normal=b.normal, support=b.support, q=still)


NOTHING = _nothing()  # returns of a scan that nothing asks for any more


class LaserRobot:
    """The estimate of one robot after the messages so far, by geometry: light is calibrated when the log is whole.

    t: [s] of it, the stamp of the latest scan that is in it; odometry: `T_odom_robot` (3,) there; None before it, or
    without any.
    """

    def __init__(self, header: Header, cfg: LaserConfig, seed: int = 0) -> None:
        self.record = LaserRecord(header)
        self.t: float | None = None
        self.odometry: np.ndarray | None = None
        self.last = 0
        self._cfg = cfg
        self._session = DrivenSession(header.log_robot, cfg, seed)
        self._told = False  # whether what comes is told once more

    def add(self, message: Numbered) -> None:
        """The estimate with the scans of `message`."""
        self.last = message.seq
        self._told |= isinstance(message, Header) and message.seq > 0
        if isinstance(message, Header) or self._told:  # it was begun with it; what is told anew it has seen
            return
        part = self.record.add(message)
        if part is None:
            return
        for event in part.events():
            if self._session.push(event) is not None and isinstance(event.record, Scan):
                self.t, self.odometry = event.t, event.record.odometry
            self._session.left.clear()

    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """`T_local_robot`, the upper triangle of its covariance, how many landmarks there are: none."""
        now = self._session.now
        cov = np.nan_to_num(now.cov)
        return tuple(now.pose.tolist()), tuple(cov[TRIANGLE].tolist()), 0

    def map(self) -> GridMap | None:
        """The grid so far, of the keyframes' scans, in the frame that poses are told in; None before the first scan."""
        graph = self._session.graph(covariances=False)
        frame = f"local_{self.record.header.log_robot}"
        return None if graph is None else render_keyframes(graph, self._cfg.resolution, frame)

    def snapshot(self) -> Snapshot | None:
        """A laser robot hands over scans alone."""
        return None
