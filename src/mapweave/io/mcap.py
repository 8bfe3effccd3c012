"""MCAP recordings that RViz, Foxglove and ROS 2 nodes open: a laser log, and a result.

Of a log: `/scan`, `/odom`, `/tf` (odom to base_link), `/tf_static` (base_link to laser; world to odom when the truth is
known), `/fix` where a receiver is aboard, and `/ground_truth`, a PoseStamped, so that no reader looking for odometry
finds the truth. Of a result, in the frame `map`: `/map` (OccupancyGrid) and `/walls` (PointCloud2) where lasers saw
any, `/landmarks` (MarkerArray), for every robot `/robotK/path` (Path) and `/robotK/pose` (PoseWithCovarianceStamped),
and `/tf` from `map` to `robotK/base_link`.
"""

import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ..core.gaussian import ellipse
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track
from ..core.se2 import quaternion_of_heading
from ..landmarks.landmark_map import LandmarkMap
from .directory import result_file
from .finished import Finished, read_finished
from .ros_map import OCCUPIED, RosMap

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


NAME = "result.mcap"
FRAME = "map"
SHOWN = 10.0  # [Hz] poses and transforms at most
FLOAT32 = 7  # sensor_msgs/PointField
CYLINDER, TEXT = 3, 9  # visualization_msgs/Marker
TALL = 0.3  # [m] of a landmark's cylinder
RESULT_TYPES = {
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/walls": "sensor_msgs/msg/PointCloud2",
    "/landmarks": "visualization_msgs/msg/MarkerArray",
    "/tf": "tf2_msgs/msg/TFMessage",
}
PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseWithCovarianceStamped"


def write_result_mcaps(folder: Path) -> None:
    """`result.mcap` beside every component of the finished result in `folder`, each in its own frame `map`."""
    for part in read_finished(folder):
        _write(part)


def _write(result: Finished) -> None:
    landmarks = result.landmarks if result.landmarks is not None and len(result.landmarks) else None
    types = {
        topic: kind
        for topic, kind in RESULT_TYPES.items()
        if topic not in {"/map", "/walls"} or result.walls is not None
    }
    if landmarks is None:
        types.pop("/landmarks")
    for robot in result.tracks:
        types |= {f"/{robot}/path": PATH, f"/{robot}/pose": POSE}
    latched = {topic for topic in types if topic in {"/map", "/walls", "/landmarks"} or topic.endswith("/path")}
    write_messages(result.folder / NAME, types, _result_messages(result.tracks, result.walls, landmarks), latched)


def _result_messages(
    tracks: Mapping[str, Track], walls: RosMap | None, landmarks: LandmarkMap | None
) -> Iterator[Message]:
    first = min((nanoseconds(track.t[0]) for track in tracks.values() if len(track.t)), default=0)
    if walls is not None:
        yield first, "/map", _occupancy(first, walls)
        yield first, "/walls", _cloud(first, walls)
    if landmarks is not None:
        yield first, "/landmarks", _markers(first, landmarks)
    for robot, track in tracks.items():
        poses = [
            message_type("PoseStamped")(header=header_message(nanoseconds(t), FRAME), pose=pose_message(pose))
            for t, pose in zip(track.t, track.pose, strict=True)
        ]
        yield first, f"/{robot}/path", message_type(PATH)(header=header_message(first, FRAME), poses=poses)
        for i in _shown(track.t):
            ns, pose = nanoseconds(track.t[i]), track.pose[i]
            frames = [transform_message(ns, FRAME, f"{robot}/base_link", pose)]
            yield ns, "/tf", message_type("tf2_msgs/msg/TFMessage")(transforms=frames)
            cov = np.zeros((6, 6)) if track.cov is None else _in_space(track.cov[i])
            estimate = message_type("PoseWithCovariance")(pose=pose_message(pose), covariance=cov.ravel())
            yield ns, f"/{robot}/pose", message_type(POSE)(header=header_message(ns, FRAME), pose=estimate)


def _shown(t: Float[np.ndarray, " n"]) -> list[int]:
    """The first pose of every tenth of a second, and the last of all."""
    if not len(t):
        return []
    bins = np.floor((t - t[0]) * SHOWN).astype(np.int64)
    return sorted({*np.unique(bins, return_index=True)[1].tolist(), len(t) - 1})


def _in_space(cov: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "6 6"]:
    """Covariance over x, y, theta as one over x, y, z and rotations about them."""
    out = np.zeros((6, 6))
    at = np.array([0, 1, 5])
    out[np.ix_(at, at)] = cov
    return out


def _occupancy(ns: int, walls: RosMap) -> Any:
    rows, cols = walls.state.shape
    origin = message_type("Pose")(
        position=message_type("Point")(x=float(walls.origin[0]), y=float(walls.origin[1]), z=0.0),
        orientation=rotation_message(float(walls.origin[2])),
    )
    header = header_message(ns, FRAME)
    info = message_type("nav_msgs/msg/MapMetaData")(
        map_load_time=header.stamp, resolution=walls.resolution, width=cols, height=rows, origin=origin
    )
    data = np.where(walls.state == OCCUPIED, 100, walls.state).astype(np.int8).ravel()
    return message_type(RESULT_TYPES["/map"])(header=header, info=info, data=data)


def _cloud(ns: int, walls: RosMap) -> Any:
    """The centres of occupied cells."""
    centres = walls.occupied()
    points = np.zeros((len(centres), 3), np.float32)
    points[:, :2] = centres
    fields = [
        message_type("sensor_msgs/msg/PointField")(name=name, offset=4 * k, datatype=FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    return message_type(RESULT_TYPES["/walls"])(
        header=header_message(ns, FRAME),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=True,
    )


def _markers(ns: int, landmarks: LandmarkMap) -> Any:
    """Each landmark as its 95 % region, and its name above."""
    markers = []
    for i, (name, (x, y)) in enumerate(zip(landmarks.ids, landmarks.mean, strict=True)):
        a, b, angle = ellipse(landmarks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])
        region, middle = (2 * max(a, 0.01), 2 * max(b, 0.01), TALL), np.array([x, y, angle])
        markers.append(_marker(ns, "landmarks", i, CYLINDER, middle, 0.5 * TALL, region))
        markers.append(_marker(ns, "names", i, TEXT, middle, TALL + 0.2, (0.0, 0.0, 0.2), text=name))
    return message_type(RESULT_TYPES["/landmarks"])(markers=markers)


def _marker(
    ns: int,
    group: str,
    number: int,
    kind: int,
    pose: Float[np.ndarray, "3"],
    z: float,
    scale: tuple[float, float, float],
    text: str = "",
) -> Any:
    qx, qy, qz, qw = quaternion_of_heading(float(pose[2]))
    colour = message_type("std_msgs/msg/ColorRGBA")
    return message_type("visualization_msgs/msg/Marker")(
        header=header_message(ns, FRAME),
        ns=group,
        id=number,
        type=kind,
        action=0,
        pose=message_type("Pose")(
            position=message_type("Point")(x=float(pose[0]), y=float(pose[1]), z=z),
            orientation=message_type("Quaternion")(x=qx, y=qy, z=qz, w=qw),
        ),
        scale=message_type("Vector3")(x=scale[0], y=scale[1], z=scale[2]),
        color=colour(r=0.84, g=0.37, b=0.0, a=0.8) if kind == CYLINDER else colour(r=1.0, g=1.0, b=1.0, a=1.0),
        lifetime=message_type("builtin_interfaces/msg/Duration")(sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=message_type("sensor_msgs/msg/CompressedImage")(
            header=header_message(ns, FRAME), format="", data=np.zeros(0, np.uint8)
        ),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=message_type("visualization_msgs/msg/MeshFile")(filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )
