"""What a ROS graph gets back: the robot's map, its pose with covariance, and where its frames lie.

`map` is kept for those that subscribe later (transient local); it is drawn anew no more often than it costs.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...io.mcap import header_message, message_type, nanoseconds, pose_message, rotation_message, transform_message
from ...laser.laser_map import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from ..laser_robot import LaserRobot
from ..robot import Listeners
from ..transport import (
    AdvancedPublisher,
    CacheConfig,
    CongestionControl,
    MissDetectionConfig,
    Session,
    declare_advanced_publisher,
)
from .cdr import GRID, POSE, TF, encode, type_hash
from .feed import Member, RosFeed
from .wire import NO_HASH, PUBLISHER, Attachment, Entity, Qos, Topic

MAP_EVERY = 3.0  # [s] by the clock
MAP_SHARE = 20.0  # the time from map to map is at least so many times what drawing one takes
TF_EVERY = 0.1  # [s]
HEARTBEAT = 0.5  # [s] after which a subscriber that missed the last message hears that there was one
UNKNOWN, FREE, OCCUPIED = -1, 0, 100
PLANE = np.array([0, 1, 5])  # x, y and the turn about z among six

Say = Callable[[str], None]


@dataclass(slots=True)
class Publisher:
    """One topic of ours. `put` counts its messages."""

    entity: Entity
    out: AdvancedPublisher
    sequence: int = 0

    def put(self, message: Any) -> None:
        assert self.entity.topic is not None  # noqa: S101  (of a publisher)
        self.sequence += 1
        attachment = Attachment(self.sequence, time.time_ns(), self.entity.gid())
        self.out.put(encode(message, self.entity.topic.kind), attachment=attachment.encode())


class RosView:
    """Publishers of one robot's estimate. `show` is called after all that came was worked in."""

    def __init__(self, session: Session, feed: RosFeed, listeners: Listeners, team: str, say: Say) -> None:
        self._session, self._feed, self._say = session, feed, say
        self._listeners, self._team = listeners, team
        self._map: Publisher | None = None
        self._pose: Publisher | None = None
        self._tf: Publisher | None = None
        self._next_map = self._next_tf = 0.0
        self._shown: float | None = None
        self._drawn = -1

    def show(self, driving: LaserRobot, *, last: bool = False) -> None:
        """Pose, transform and map, each when it is due; last: the map at once, when scans came since."""
        if driving.t is None or self._feed.robot is None or self._feed.member is None:
            return
        if self._map is None:
            self._declare(self._feed.member)
        now = time.monotonic()
        if driving.t != self._shown:
            self._shown = driving.t
            self._tell_pose(driving)
        if now >= self._next_tf:
            self._next_tf = now + TF_EVERY
            self._tell_transform(driving)
        if (last or now >= self._next_map) and driving.record.scans != self._drawn:
            self._drawn = driving.record.scans
            self._tell_map(driving)
            took = time.monotonic() - now
            self._next_map = now + max(MAP_EVERY, MAP_SHARE * took)

    @property
    def frame(self) -> str:
        """The frame of the map: `map`, of a robot with a namespace `NAMESPACE/map`."""
        name = self._feed.robot.name if self._feed.robot else ""
        return f"{name}/map" if name else "map"

    def shared_frame(self, part: int) -> str:
        """The frame of the team's map: `TEAM_map`; of its smaller parts `TEAM_map_2` and so on."""
        return f"{self._team}_map" + (f"_{part}" if part > 1 else "")

    def _declare(self, member: Member) -> None:
        robot = self._feed.robot
        assert robot is not None  # noqa: S101  (shown only then)
        root = f"/{robot.name}" if robot.name else ""
        others = self._feed.graph.publishers_of(f"{root}/map", str(self._session.info.zid()))
        if others:
            self._say(
                f"{self._feed.asked.name}: {others[0]} publishes {root}/map: ours is {root}/mapweave/map, "
                "and no transform is told"
            )
            root += "/mapweave"
        hashed = robot.scan.type_hash != NO_HASH
        latched = Qos(transient_local=True, depth=1)
        self._map = self._publisher(member, f"{root}/map", GRID, latched, hashed=hashed)
        self._pose = self._publisher(member, f"{root}/pose", POSE, Qos(depth=10), hashed=hashed)
        if not others:
            moving = [t.name for t in robot.tf if not t.qos.transient_local]
            self._tf = self._publisher(member, moving[0] if moving else "/tf", TF, Qos(depth=100), hashed=hashed)

    def _publisher(self, member: Member, name: str, kind: str, qos: Qos, *, hashed: bool) -> Publisher:
        entity = member.declare(PUBLISHER, Topic(name, kind, type_hash(kind) if hashed else NO_HASH, qos))
        assert entity.topic is not None  # noqa: S101  (just given)
        kept = qos.transient_local
        out = declare_advanced_publisher(
            self._session,
            entity.topic.key(member.domain),
            cache=CacheConfig(max_samples=qos.depth) if kept else None,
            publisher_detection=kept,
            sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT) if kept else None,
            congestion_control=CongestionControl.DROP,
        )
        return Publisher(entity, out)

    def _tell_pose(self, driving: LaserRobot) -> None:
        pose, triangle, _ = driving.status()
        if self._pose is not None:
            self._pose.put(pose_of(nanoseconds(driving.t or 0.0), self.frame, np.array(pose), np.array(triangle)))

    def _tell_transform(self, driving: LaserRobot) -> None:
        """`T_map_odom` at the latest odometry; of a robot without any `T_map_robot` at the latest scan.

        Where a map process has the robot in its map, `T_shared_map` too: so all robots of the team are in one frame.
        """
        a = self._feed.assembly
        pose, wheels = np.array(driving.status()[0]), driving.odometry
        if self._tf is None or not a.base_frame:
            return
        if wheels is None:
            child, t = a.base_frame, driving.t or 0.0
        else:
            if a.latest is None or not a.odom_frame:
                return
            pose = np.asarray(se2.compose(pose, se2.inverse(wheels)))
            child, t = a.odom_frame, a.latest[0]
        edges = [transform_message(nanoseconds(t), self.frame, child, pose)]
        if (shared := self._listeners.shared) is not None:
            part, correction = shared
            edges.append(
                transform_message(nanoseconds(t), self.shared_frame(part), self.frame, np.array(correction.pose))
            )
        self._tf.put(message_type(TF)(transforms=edges))

    def _tell_map(self, driving: LaserRobot) -> None:
        grid = driving.map()
        if grid is not None and self._map is not None:
            self._map.put(grid_of(nanoseconds(driving.t or 0.0), self.frame, grid))


def grid_of(ns: int, frame: str, grid: GridMap) -> Any:
    """An OccupancyGrid: 100 occupied, 0 free, -1 not seen or not sure, by the thresholds of our map files."""
    p = grid.occupancy()
    data = np.full(p.shape, UNKNOWN, np.int8)
    data[p < FREE_BELOW] = FREE
    data[p > OCCUPIED_ABOVE] = OCCUPIED
    rows, cols = grid.shape
    header = header_message(ns, frame)
    origin = message_type("Pose")(
        position=message_type("Point")(x=float(grid.origin[0]), y=float(grid.origin[1]), z=0.0),
        orientation=rotation_message(0.0),
    )
    info = message_type("nav_msgs/msg/MapMetaData")(
        map_load_time=header.stamp, resolution=float(grid.resolution), width=cols, height=rows, origin=origin
    )
    return message_type(GRID)(header=header, info=info, data=data.ravel())


def pose_of(ns: int, frame: str, pose: Float[np.ndarray, "3"], triangle: Float[np.ndarray, "6"]) -> Any:
    """A PoseWithCovarianceStamped. triangle: xx, xy, xt, yy, yt, tt."""
    cov = np.zeros((6, 6))
    cov[PLANE[np.triu_indices(3)[0]], PLANE[np.triu_indices(3)[1]]] = triangle
    cov = cov + np.triu(cov, 1).T
    estimate = message_type("PoseWithCovariance")(pose=pose_message(pose), covariance=cov.ravel())
    return message_type(POSE)(header=header_message(ns, frame), pose=estimate)
