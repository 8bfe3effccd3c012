"""Laser logs from ROS recordings: scans and odometry found by type, sensor poses from tf."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan
from .bag import Bag, bag_hash, open_bag
from .transforms import Transforms, frame, planar, rigid

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


def read_ros(
    path: Path,
    robot: str,
    *,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    sensor_pose: Sequence[float] | None = None,
    mirrored: bool = False,
) -> LaserLog:
    """The log in a ROS 1 or ROS 2 recording; the fullest topic of a type is taken unless one is named.

    `odom_topic` may name a tf topic. Stamps are those of the message headers. Raises ReaderError, listing what is
    there, for a topic that is not.
    """
    bag = open_bag(path, (SCAN, ODOMETRY, *TF))
    raw = RawLog(robot, str(path), bag_hash(path))
    if bag.lost:
        raw.warnings.append(f"{path.name}: {bag.lost}; they are used")
    scans = _choose(bag, raw, scan_topic, (SCAN,), "scan")
    wheels = _choose(bag, raw, odom_topic, (ODOMETRY, *TF) if odom_topic else (ODOMETRY,), "odometry")
    if scans is None:
        raise ReaderError(path, f"no LaserScan topic; there are {bag.listing() or 'no topics'}")
    tf = Transforms()
    messages: list[tuple[float, Any]] = []
    robot_frame: Counter[str] = Counter()
    for topic, ns, message in bag.messages({scans, *bag.topics(*TF), *([wheels] if wheels else [])}):
        if topic == scans:
            messages.append((_stamp(message.header, ns), message))
        elif bag.kinds[topic] in TF:
            for transform in message.transforms:
                tf.add(_stamp(transform.header, ns), transform)
        else:
            pose = planar(rigid(message.pose.pose.position, message.pose.pose.orientation))
            raw.odometry.append((_stamp(message.header, ns), *pose))
            robot_frame[frame(message.child_frame_id)] += 1
            raw.odometry_from = "poses"
    sensor = frame(messages[0][1].header.frame_id) if messages else ""
    edge = tf.odometry_edge(sensor)
    if not raw.odometry and edge is not None:
        raw.odometry = [(t, *planar(transform)) for t, transform in tf.seen[edge]]
        raw.odometry_from = "tf"
        robot_frame[edge[1]] += 1
    base = robot_frame.most_common(1)[0][0] if robot_frame else (edge[1] if edge else "")
    _add_scans(raw, messages, tf, base, given=sensor_pose is not None)
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _choose(bag: Bag, raw: RawLog, wanted: str | None, kinds: Sequence[str], what: str) -> str | None:
    there = bag.topics(*kinds)
    if wanted is not None:
        for topic in there:
            if topic.lstrip("/") == wanted.lstrip("/"):
                return topic
        raise ReaderError(bag.path, f"no {what} topic {wanted!r}; there are {bag.listing() or 'no topics'}")
    if len(there) > 1:
        raw.warnings.append(f"{what} is read from {there[0]}; there is also {', '.join(there[1:])}")
    return there[0] if there else None


def _add_scans(raw: RawLog, messages: list[tuple[float, Any]], tf: Transforms, base: str, *, given: bool) -> None:
    places: dict[str, tuple[np.ndarray, bool]] = {}
    for t, message in messages:
        name = frame(message.header.frame_id)
        if name not in places:
            found = tf.sensor_pose(base, name)
            if found is None:
                found = np.zeros(3), False
                if not given:
                    raw.warnings.append(
                        f"no transform from {base or 'the robot'} to {name or 'the laser'}: the sensor is taken to "
                        "stand at the robot's origin (give --sensor-pose if not)"
                    )
            places[name] = found
        pose, upside_down = places[name]
        n, sign = len(message.ranges), -1.0 if upside_down else 1.0
        step = message.angle_increment or (message.angle_max - message.angle_min) / max(1, n - 1)
        light = np.asarray(message.intensities, dtype=float)
        raw.scans.append(
            RawScan(
                t,
                np.asarray(message.ranges, dtype=float),
                light if len(light) else None,
                sign * float(message.angle_min),
                sign * float(step),
                float(message.range_min),
                float(message.range_max) if message.range_max > 0 else np.inf,
                pose,
            )
        )


def _stamp(header: Any, recorded: int) -> float:
    """Header time [s]; the recording's where the header has none."""
    ns = header.stamp.sec * 10**9 + header.stamp.nanosec
    return float((ns or recorded) / 1e9)
