"""A laser log as an MCAP recording that Foxglove and ROS 2 open: scans, odometry, transforms, the truth apart.

Topics: `/scan`, `/odom`, `/tf` (odom to base_link), `/tf_static` (base_link to laser; world to odom when the truth is
known) and `/ground_truth`, a PoseStamped, so that no reader looking for odometry finds the truth.
"""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ..core.laser_log import LaserLog
from ..core.records import Scan, Track
from ..core.se2 import quaternion_of_heading
from .directory import result_file

STORE = get_typestore(Stores.ROS2_HUMBLE)
ODOM, BASE, LASER, WORLD = "odom", "base_link", "laser", "world"
NEVER = QosTime(2147483647, 4294967295)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    NEVER,
    NEVER,
    QosLiveliness.AUTOMATIC,
    NEVER,
    False,
)
Message = tuple[int, str, Any]  # time [ns], topic, message
TYPES = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}


def write_mcap(path: Path, log: LaserLog, truth: Track | None = None, *, range_min: float = 0.0) -> None:
    """`path` holds the log; reading it back gives the same events, to the bit where they fit the messages.

    They do when ranges, intensities and angles are 32-bit numbers, headings are rounded (`se2.representable_heading`)
    and stamps are whole nanoseconds, as simulated ones are. All scans must come from one sensor.
    """
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / path.stem
        writer = Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP)
        with writer:
            connections = {
                topic: writer.add_connection(
                    topic, kind, typestore=STORE, offered_qos_profiles=[LATCHED] if topic == "/tf_static" else []
                )
                for topic, kind in TYPES.items()
                if topic != "/ground_truth" or truth is not None
            }
            for ns, topic, message in sorted(_messages(log, truth, range_min), key=lambda m: m[0]):
                writer.write(connections[topic], ns, STORE.serialize_cdr(message, TYPES[topic]))
        with result_file(path) as work:
            next(bag.glob("*.mcap")).replace(work)


def _messages(log: LaserLog, truth: Track | None, range_min: float) -> Iterator[Message]:
    first = _ns(min([*log.scan_t[:1], *([] if log.odometry is None else log.odometry.t[:1])]))
    still = [_transform(first, BASE, LASER, log.scans[0].T_robot_sensor)]
    if truth is not None:
        still.append(_transform(first, WORLD, ODOM, truth.pose[0]))
        for t, pose in zip(truth.t, truth.pose, strict=True):
            yield _ns(t), "/ground_truth", _type("PoseStamped")(header=_header(_ns(t), WORLD), pose=_pose(pose))
    yield first, "/tf_static", _type("tf2_msgs/msg/TFMessage")(transforms=still)
    if log.odometry is not None:
        for t, pose in zip(log.odometry.t, log.odometry.pose, strict=True):
            ns = _ns(t)
            yield ns, "/tf", _type("tf2_msgs/msg/TFMessage")(transforms=[_transform(ns, ODOM, BASE, pose)])
            yield ns, "/odom", _odometry(ns, pose)
    steps = np.diff(log.scan_t)
    every = float(np.median(steps)) if len(steps) else 0.0
    for t, scan in zip(log.scan_t, log.scans, strict=True):
        yield _ns(t), "/scan", _scan(_ns(t), scan, range_min, every)


def _scan(ns: int, scan: Scan, range_min: float, every: float) -> Any:
    ranges = np.where(scan.hit, scan.ranges, np.inf).astype(np.float32)  # REP 117: infinite is no return
    light = np.zeros(0) if scan.intensities is None else scan.intensities
    return _type("sensor_msgs/msg/LaserScan")(
        header=_header(ns, LASER),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * (len(ranges) - 1),
        angle_increment=scan.angle_increment,
        time_increment=0.0,
        scan_time=every,
        range_min=range_min,
        range_max=scan.range_max,
        ranges=ranges,
        intensities=light.astype(np.float32),
    )


def _odometry(ns: int, pose: Float[np.ndarray, "3"]) -> Any:
    still = _type("Vector3")(x=0.0, y=0.0, z=0.0)
    return _type("nav_msgs/msg/Odometry")(
        header=_header(ns, ODOM),
        child_frame_id=BASE,
        pose=_type("PoseWithCovariance")(pose=_pose(pose), covariance=np.zeros(36)),
        twist=_type("TwistWithCovariance")(twist=_type("Twist")(linear=still, angular=still), covariance=np.zeros(36)),
    )


def _pose(pose: Float[np.ndarray, "3"]) -> Any:
    return _type("Pose")(
        position=_type("Point")(x=float(pose[0]), y=float(pose[1]), z=0.0), orientation=_rotation(float(pose[2]))
    )


def _transform(ns: int, parent: str, child: str, pose: Float[np.ndarray, "3"]) -> Any:
    return _type("TransformStamped")(
        header=_header(ns, parent),
        child_frame_id=child,
        transform=_type("Transform")(
            translation=_type("Vector3")(x=float(pose[0]), y=float(pose[1]), z=0.0),
            rotation=_rotation(float(pose[2])),
        ),
    )


def _rotation(theta: float) -> Any:
    x, y, z, w = quaternion_of_heading(theta)
    return _type("Quaternion")(x=x, y=y, z=z, w=w)


def _header(ns: int, frame: str) -> Any:
    stamp = _type("builtin_interfaces/msg/Time")(sec=ns // 10**9, nanosec=ns % 10**9)
    return _type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)


def _type(name: str) -> Callable[..., Any]:
    return STORE.types[name if "/" in name else f"geometry_msgs/msg/{name}"]  # type: ignore[no-any-return]


def _ns(t: float) -> int:
    return round(float(t) * 1e9)
