"""A laser log as an MCAP recording that Foxglove and ROS 2 open: scans, odometry, transforms, the truth apart.

Topics: `/scan`, `/odom`, `/tf` (odom to base_link), `/tf_static` (base_link to laser; world to odom when the truth is
known), `/fix` where a receiver is aboard, and `/ground_truth`, a PoseStamped, so that no reader looking for odometry
finds the truth.
"""

import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
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
    "/fix": "sensor_msgs/msg/NavSatFix",
}


def write_mcap(path: Path, log: LaserLog, truth: Track | None = None, *, range_min: float = 0.0) -> None:
    """`path` holds the log; reading it back gives the same events, to the bit where they fit the messages.

    They do when ranges, intensities and angles are 32-bit numbers, headings are rounded (`se2.representable_heading`)
    and stamps are whole nanoseconds, as simulated ones are. All scans must come from one sensor.
    """
    absent = {"/ground_truth": truth is None, "/fix": log.fixes is None}
    types = {topic: kind for topic, kind in TYPES.items() if not absent.get(topic)}
    write_messages(path, types, _messages(log, truth, range_min), {"/tf_static"})


def write_messages(path: Path, types: Mapping[str, str], messages: Iterable[Message], latched: Collection[str]) -> None:
    """`path` is a recording of `messages` in the order of their times. types: topic -> type.

    latched: topics that tell who comes late what they told last.
    """
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / path.stem
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                topic: writer.add_connection(
                    topic, kind, typestore=STORE, offered_qos_profiles=[LATCHED] if topic in latched else []
                )
                for topic, kind in types.items()
            }
            for ns, topic, message in sorted(messages, key=lambda m: m[0]):
                writer.write(connections[topic], ns, STORE.serialize_cdr(message, types[topic]))
        with result_file(path) as work:
            shutil.move(next(bag.glob("*.mcap")), work)  # the folder may be on another file system


def _messages(log: LaserLog, truth: Track | None, range_min: float) -> Iterator[Message]:
    first = nanoseconds(min([*log.scan_t[:1], *([] if log.odometry is None else log.odometry.t[:1])]))
    still = [transform_message(first, BASE, LASER, log.scans[0].T_robot_sensor)]
    if truth is not None:
        still.append(transform_message(first, WORLD, ODOM, truth.pose[0]))
        for t, pose in zip(truth.t, truth.pose, strict=True):
            yield (
                nanoseconds(t),
                "/ground_truth",
                message_type("PoseStamped")(header=header_message(nanoseconds(t), WORLD), pose=pose_message(pose)),
            )
    yield first, "/tf_static", message_type("tf2_msgs/msg/TFMessage")(transforms=still)
    if log.odometry is not None:
        for t, pose in zip(log.odometry.t, log.odometry.pose, strict=True):
            ns = nanoseconds(t)
            yield (
                ns,
                "/tf",
                message_type("tf2_msgs/msg/TFMessage")(transforms=[transform_message(ns, ODOM, BASE, pose)]),
            )
            yield ns, "/odom", odometry_message(ns, pose)
    if log.fixes is not None:
        for t, place, cov in zip(log.fixes.t, log.fixes.place, log.fixes.cov, strict=True):
            yield nanoseconds(t), "/fix", fix_message(nanoseconds(t), place, cov)
    steps = np.diff(log.scan_t)
    every = float(np.median(steps)) if len(steps) else 0.0
    for t, scan in zip(log.scan_t, log.scans, strict=True):
        yield nanoseconds(t), "/scan", _scan(nanoseconds(t), scan, range_min, every, abs(log.sweep))


def _scan(ns: int, scan: Scan, range_min: float, every: float, sweep: float) -> Any:
    ranges = np.where(scan.hit, scan.ranges, np.inf).astype(np.float32)  # REP 117: infinite is no return
    light = np.zeros(0) if scan.intensities is None else scan.intensities
    return message_type("sensor_msgs/msg/LaserScan")(
        header=header_message(ns, LASER),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * (len(ranges) - 1),
        angle_increment=scan.angle_increment,
        time_increment=sweep / max(len(ranges) - 1, 1),
        scan_time=every,
        range_min=range_min,
        range_max=scan.range_max,
        ranges=ranges,
        intensities=light.astype(np.float32),
    )


def fix_message(ns: int, place: Float[np.ndarray, "3"], cov: Float[np.ndarray, "2 2"]) -> Any:
    known = bool(np.isfinite(cov).all())
    full = np.zeros((3, 3))
    full[:2, :2] = cov if known else 0.0
    return message_type("sensor_msgs/msg/NavSatFix")(
        header=header_message(ns, BASE),
        status=message_type("sensor_msgs/msg/NavSatStatus")(status=0, service=1),
        latitude=float(place[0]),
        longitude=float(place[1]),
        altitude=float(place[2]),
        position_covariance=full.ravel(),
        position_covariance_type=2 if known else 0,
    )


def odometry_message(ns: int, pose: Float[np.ndarray, "3"]) -> Any:
    still = message_type("Vector3")(x=0.0, y=0.0, z=0.0)
    return message_type("nav_msgs/msg/Odometry")(
        header=header_message(ns, ODOM),
        child_frame_id=BASE,
        pose=message_type("PoseWithCovariance")(pose=pose_message(pose), covariance=np.zeros(36)),
        twist=message_type("TwistWithCovariance")(
            twist=message_type("Twist")(linear=still, angular=still), covariance=np.zeros(36)
        ),
    )


def pose_message(pose: Float[np.ndarray, "3"]) -> Any:
    return message_type("Pose")(
        position=message_type("Point")(x=float(pose[0]), y=float(pose[1]), z=0.0),
        orientation=rotation_message(float(pose[2])),
    )


def transform_message(ns: int, parent: str, child: str, pose: Float[np.ndarray, "3"]) -> Any:
    return message_type("TransformStamped")(
        header=header_message(ns, parent),
        child_frame_id=child,
        transform=message_type("Transform")(
            translation=message_type("Vector3")(x=float(pose[0]), y=float(pose[1]), z=0.0),
            rotation=rotation_message(float(pose[2])),
        ),
    )


def rotation_message(theta: float) -> Any:
    x, y, z, w = quaternion_of_heading(theta)
    return message_type("Quaternion")(x=x, y=y, z=z, w=w)


def header_message(ns: int, frame: str) -> Any:
    stamp = message_type("builtin_interfaces/msg/Time")(sec=ns // 10**9, nanosec=ns % 10**9)
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)


def message_type(name: str) -> Callable[..., Any]:
    return STORE.types[name if "/" in name else f"geometry_msgs/msg/{name}"]  # type: ignore[no-any-return]


def nanoseconds(t: float) -> int:
    return round(float(t) * 1e9)
