"""What a ROS graph gets back: the robot's map, its pose with covariance, where its frames lie, what its team tells.

`map` is kept for those that subscribe later (transient local); it is drawn anew no more often than it costs.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.errors import DataError
from ...io.mcap import header_message, message_type, nanoseconds, pose_message, rotation_message, transform_message
from ...laser.laser_map import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from ..driven import LaserRobot
from ..robot import Listeners
from ..told import LiveTeam, TeamGrid
from ..transport import (
    AdvancedPublisher,
    CacheConfig,
    CongestionControl,
    MissDetectionConfig,
    Session,
    declare_advanced_publisher,
)
from .feed import RosFeed
from .wire import GOAL, GRID, NO_HASH, POSE, PUBLISHER, TF, Attachment, Entity, Qos, Topic, encode, type_hash

MAP_EVERY = 3.0  # [s] by the clock
MAP_SHARE = 20.0  # the time from map to map is at least so many times what drawing one takes
TF_EVERY = 0.1  # [s]
POSES_EVERY = 0.5  # [s] between other robots' poses
MOST_OTHERS = 64  # robots of the team whose poses are published
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
        told = None
        if not self.entity.topic.bridged:
            told = Attachment(self.sequence, time.time_ns(), self.entity.gid()).encode()
        self.out.put(encode(message, self.entity.topic.kind), attachment=told)


class RosView:
    """Publishers of one robot's estimate. `show` is called after all that came was worked in.

    told: what the team knows, where that is published too, and goals where `goals` says so.
    """

    def __init__(
        self, session: Session, feed: RosFeed, listeners: Listeners, team: str, say: Say, told: LiveTeam, *,
        shared: bool = False, goals: bool = False,
    ) -> None:  # fmt: skip
        self._session, self._feed, self._say = session, feed, say
        self._listeners, self._team = listeners, team
        self._told = TeamTopics(told, feed.asked.name, self, say, shared=shared, goals=goals)
        self._map: Publisher | None = None
        self._pose: Publisher | None = None
        self._tf: Publisher | None = None
        self._next_map = self._next_tf = 0.0
        self._shown: float | None = None
        self._drawn = -1

    def show(self, driving: LaserRobot) -> None:
        """Pose, transform and map, each when it is due."""
        if driving.t is None or self._feed.robot is None or self._feed.member is None:
            return
        if self._map is None:
            self._declare()
        now = time.monotonic()
        if driving.t != self._shown:
            self._shown = driving.t
            self._tell_pose(driving)
        if now >= self._next_tf:
            self._next_tf = now + TF_EVERY
            self._tell_transform(driving)
        if now >= self._next_map and driving.record.scans != self._drawn:
            self._drawn = driving.record.scans
            self._tell_map(driving)
            took = time.monotonic() - now
            self._next_map = now + max(MAP_EVERY, MAP_SHARE * took)
        self._told.show(nanoseconds(driving.t))

    @property
    def frame(self) -> str:
        """The frame of the map: `map`, of a robot with a namespace `NAMESPACE/map`."""
        name = self._feed.robot.name if self._feed.robot else ""
        return f"{name}/map" if name else "map"

    @property
    def root(self) -> str:
        """The robot's namespace, with its slash before it; empty where there is none."""
        name = self._feed.robot.name if self._feed.robot else ""
        return f"/{name}" if name else ""

    def shared_frame(self, part: int) -> str:
        """The frame of the team's map: `TEAM_map`; of its smaller parts `TEAM_map_2` and so on."""
        return f"{self._team}_map" + (f"_{part}" if part > 1 else "")

    def _declare(self) -> None:
        robot = self._feed.robot
        assert robot is not None  # noqa: S101  (shown only then)
        root = self.root
        others = self._feed.graph.publishers_of(f"{root}/map", str(self._session.info.zid()))
        if others:
            self._say(
                f"{self._feed.asked.name}: {others[0]} publishes {root}/map: ours is {root}/mapweave/map, "
                "and no transform is told"
            )
            root += "/mapweave"
        latched = Qos(transient_local=True, depth=1)
        self._map = self.publisher(f"{root}/map", GRID, latched)
        self._pose = self.publisher(f"{root}/pose", POSE, Qos(depth=10))
        if not others:
            moving = [t.name for t in robot.tf if not t.qos.transient_local]
            self._tf = self.publisher(moving[0] if moving else "/tf", TF, Qos(depth=100))

    def publisher(self, name: str, kind: str, qos: Qos) -> Publisher:
        """A topic of ours, once the robot is known."""
        member, robot = self._feed.member, self._feed.robot
        assert member is not None and robot is not None  # noqa: S101, PT018  (shown only then)
        hashed = robot.scan.type_hash != NO_HASH
        told = type_hash(kind) if hashed else NO_HASH
        entity = member.declare(PUBLISHER, Topic(name, kind, told, qos, bridged=robot.scan.bridged))
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


class TeamTopics:
    """Publishers of what the team tells one robot, below its namespace.

    `team_map` and, for each other robot in the same part, `team/NAME/pose`, both in the part's frame; `goal_pose`,
    which Nav2 drives to, as often as the goal is another.
    """

    def __init__(self, team: LiveTeam, name: str, view: RosView, say: Say, *, shared: bool, goals: bool) -> None:
        self._team, self._name, self._view, self._say = team, name, view, say
        self._shared, self._goals = shared, goals
        self._map: Publisher | None = None
        self._goal: Publisher | None = None
        self._poses: dict[str, Publisher] = {}
        self._next_map = self._next_poses = 0.0
        self._sent: tuple[int, int] | None = None  # the goal's part and number

    def show(self, ns: int) -> None:
        """What is due, with a stamp [ns]."""
        robots = self._team.robots() if self._shared or self._goals else {}
        mine = robots.get(self._name)
        if mine is None or not mine.part:
            return
        frame, now = self._view.shared_frame(mine.part), time.monotonic()
        if self._shared and now >= self._next_poses:
            self._next_poses = now + POSES_EVERY
            for other in robots.values():
                if other.name == self._name or other.part != mine.part or other.pose is None or other.cov is None:
                    continue
                if other.name not in self._poses and len(self._poses) < MOST_OTHERS:
                    topic = f"{self._view.root}/team/{topic_name(other.name)}/pose"
                    self._poses[other.name] = self._view.publisher(topic, POSE, Qos(depth=10))
                if other.name in self._poses:
                    triangle = other.cov[np.triu_indices(3)]
                    self._poses[other.name].put(pose_of(ns, frame, other.pose, triangle))
        if self._shared and now >= self._next_map:
            self._tell_map(ns, frame, mine.part)
            self._next_map = now + max(MAP_EVERY, MAP_SHARE * (time.monotonic() - now))
        goal = self._team.goal(self._name) if self._goals else None
        if goal is not None and self._sent != (goal.part, goal.number):
            self._sent = goal.part, goal.number
            self._goal = self._goal or self._view.publisher(f"{self._view.root}/goal_pose", GOAL, Qos(depth=10))
            header = header_message(ns, self._view.shared_frame(goal.part))
            self._goal.put(message_type(GOAL)(header=header, pose=pose_message(goal.pose)))

    def _tell_map(self, ns: int, frame: str, part: int) -> None:
        try:
            grid = self._team.grid(part)
        except DataError as error:
            self._say(f"{self._name}: {error}: the team's map is not published")
            self._shared = False
            return
        if grid is not None:
            latched = Qos(transient_local=True, depth=1)
            self._map = self._map or self._view.publisher(f"{self._view.root}/team_map", GRID, latched)
            self._map.put(grid_of(ns, frame, grid))


def topic_name(name: str) -> str:
    """The name of a robot as part of a ROS topic's, which holds letters, digits and underscores."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if not plain[0].isdigit() else f"_{plain}"


def grid_of(ns: int, frame: str, grid: GridMap | TeamGrid) -> Any:
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
