"""A result as a recording that RViz, Foxglove and ROS 2 nodes open: the map, every robot's path, landmarks, walls.

Topics, all in the frame `map`: `/map` (OccupancyGrid) and `/walls` (PointCloud2) where lasers saw any, `/landmarks`
(MarkerArray), for every robot `/robotK/path` (Path) and `/robotK/pose` (PoseWithCovarianceStamped), and `/tf` from
`map` to `robotK/base_link`.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.gaussian import ellipse
from ..core.records import Track
from ..core.se2 import quaternion_of_heading
from ..landmarks.landmark_map import LandmarkMap
from .finished import Finished, read_finished
from .mcap import (
    Message,
    header_message,
    message_type,
    nanoseconds,
    pose_message,
    rotation_message,
    transform_message,
    write_messages,
)
from .ros_map import OCCUPIED, RosMap

NAME = "result.mcap"
FRAME = "map"
SHOWN = 10.0  # [Hz] poses and transforms at most
FLOAT32 = 7  # sensor_msgs/PointField
CYLINDER, TEXT = 3, 9  # visualization_msgs/Marker
TALL = 0.3  # [m] of a landmark's cylinder
TYPES = {
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
        topic: kind for topic, kind in TYPES.items() if topic not in {"/map", "/walls"} or result.walls is not None
    }
    if landmarks is None:
        types.pop("/landmarks")
    for robot in result.tracks:
        types |= {f"/{robot}/path": PATH, f"/{robot}/pose": POSE}
    latched = {topic for topic in types if topic in {"/map", "/walls", "/landmarks"} or topic.endswith("/path")}
    write_messages(result.folder / NAME, types, _messages(result.tracks, result.walls, landmarks), latched)


def _messages(tracks: Mapping[str, Track], walls: RosMap | None, landmarks: LandmarkMap | None) -> Iterator[Message]:
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
    return message_type(TYPES["/map"])(header=header, info=info, data=data)


def _cloud(ns: int, walls: RosMap) -> Any:
    """The centres of occupied cells."""
    centres = walls.occupied()
    points = np.zeros((len(centres), 3), np.float32)
    points[:, :2] = centres
    fields = [
        message_type("sensor_msgs/msg/PointField")(name=name, offset=4 * k, datatype=FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    return message_type(TYPES["/walls"])(
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
    return message_type(TYPES["/landmarks"])(markers=markers)


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
