"""Tags and objects that a camera names, from ROS recordings, as landmark logs: range, bearing and name.

Poses come with the detections (of apriltag_ros, aruco, fiducials, vision_msgs), or as transforms from the camera to
frames called like tags (apriltag_ros of ROS 2). `nav_msgs/Odometry`, or tf, tells the velocities.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import ReaderError
from ..core.findings import Finding, Unused
from ..core.fixes import Fixes
from .bag import UNPACKABLE, Bag, open_bag, stamp
from .bag_robots import FIXES, ODOMETRY, SCANS, TF, BagRobot, bag_robots
from .clouds import OPTICAL
from .fixes import POSES, fix_row, positions_read, read_fixes, topics_of_fixes, why_no_fixes
from .salvage import DAMAGE
from .transforms import FARTHEST, NOWHERE, Rigid, Transforms, frame, planar, rigid, rotation_matrix

FRAME = re.compile(
    r"(?:^|/)(?:april)?(?:tag|aruco|ar_?marker|marker|fiducial|fid)[0-9a-z]*[:_\- ]?(\d+)$", re.IGNORECASE
)
IMAGES = "apriltag_msgs/msg/AprilTagDetectionArray"  # corners in the image; the poses are frames
TWICE = 0.3  # [m] between two sightings of one name in one frame, from which they are of two things


class Sighting(NamedTuple):
    """name: of what is seen; frame: of the camera; at: (3,) its place there [m]."""

    name: str
    frame: str
    at: Float[np.ndarray, "3"]


def _place(position: Any) -> Float[np.ndarray, "3"]:
    return np.array([position.x, position.y, position.z], dtype=float)


def _apriltag_ros(message: Any) -> Iterator[Sighting]:
    for one in message.detections:
        name = "-".join(str(int(k)) for k in one.id)  # a bundle has several
        yield Sighting(name, message.header.frame_id or one.pose.header.frame_id, _place(one.pose.pose.pose.position))


def _aruco(message: Any) -> Iterator[Sighting]:
    for one in message.markers:
        name = one.id if hasattr(one, "id") else one.marker_id
        pose = one.pose.pose if hasattr(one.pose, "pose") else one.pose
        yield Sighting(str(int(name)), message.header.frame_id, _place(pose.position))


def _ros2_aruco(message: Any) -> Iterator[Sighting]:
    for name, pose in zip(message.marker_ids, message.poses, strict=True):
        yield Sighting(str(int(name)), message.header.frame_id, _place(pose.position))


def _fiducials(message: Any) -> Iterator[Sighting]:
    for one in message.transforms:
        yield Sighting(str(int(one.fiducial_id)), message.header.frame_id, _place(one.transform.translation))


def _objects(message: Any) -> Iterator[Sighting]:
    """The likeliest of what each detection may be, by its own id where it has one, else by its class."""
    for one in message.detections:
        if not len(one.results):
            continue
        best = max(one.results, key=lambda r: r.hypothesis.score if hasattr(r, "hypothesis") else r.score)
        kind = best.hypothesis.class_id if hasattr(best, "hypothesis") else best.id
        name = str(getattr(one, "id", "") or kind).strip()
        at = _place(best.pose.pose.position)
        at = at if at.any() else _place(one.bbox.center.position)
        yield Sighting(name, one.header.frame_id or message.header.frame_id, at)


SIGHTINGS: dict[str, Callable[[Any], Iterator[Sighting]]] = {
    "apriltag_ros/msg/AprilTagDetectionArray": _apriltag_ros,
    "aruco_msgs/msg/MarkerArray": _aruco,
    "aruco_opencv_msgs/msg/ArucoDetection": _aruco,
    "ros2_aruco_interfaces/msg/ArucoMarkers": _ros2_aruco,
    "fiducial_msgs/msg/FiducialTransformArray": _fiducials,
    "vision_msgs/msg/Detection3DArray": _objects,
}
TAGS = (*SIGHTINGS, IMAGES)


def has_tags(path: Path) -> bool:
    """Whether the recording at `path` tells of tags and holds no scan; one that cannot be opened does not."""
    try:
        bag = open_bag(path, ())
        kinds = {bag.kinds[topic] for topic in bag.kinds if bag.counts.get(topic)}
        if kinds & set(SCANS):
            return False
        if kinds & set(TAGS):
            return True
        tf = _transforms(open_bag(path, TF)) if kinds & set(TF) else Transforms()
        return any(FRAME.search(child) for _, child in tf.seen)
    except ReaderError:
        return False


class TagLog(NamedTuple):
    """What one robot of a recording drove and saw.

    number: of the robot; drive: (n, 3) t [s], v [m/s], w [rad/s]; seen: (m, 3) t, range [m], bearing [rad]; names: (m)
    of what was seen.
    """

    number: int
    drive: Float[np.ndarray, "n 3"]
    seen: Float[np.ndarray, "m 3"]
    names: list[str]
    dropped: dict[str, int]
    findings: list[Finding]
    unused: list[Unused]
    fixes: Fixes | None


def read_tags(path: Path, place: int = 1, fixes: str | None = None) -> list[TagLog]:
    """The robots in the recording at `path` that saw tags. Raises ReaderError where none did, listing what there is.

    A robot's number is the last in its name, or in the name of the file; else they are counted from `place` on. fixes:
    topics that tell where a robot was, by default satellites alone.
    """
    bag = open_bag(path, (*TAGS, ODOMETRY, *TF, *FIXES))
    robots = bag_robots(bag, TAGS) or (_only(bag),)
    logs = [_read(bag, robot, k, fixes) for robot, k in zip(robots, _numbers(robots, path, place), strict=True)]
    if not any(log.names for log in logs):
        raise ReaderError(path, f"no tag with a pose in it; there are {bag.listing() or 'no topics'}")
    return logs


def _only(bag: Bag) -> BagRobot:
    """The robot of a recording whose tags are frames of tf."""
    told = tuple(topic for topic in bag.topics(*FIXES) if bag.counts.get(topic))
    return BagRobot("", (), tuple(bag.topics(ODOMETRY)), tuple(bag.topics(*TF)), fixes=told)


def _numbers(robots: Sequence[BagRobot], path: Path, place: int) -> list[int]:
    own = [re.findall(r"\d+", robot.name) for robot in robots]
    if len(robots) == 1 and not own[0]:
        own = [re.findall(r"robot[_-]?(\d+)", path.name, re.IGNORECASE)]
    told = [int(words[-1]) for words in own if words]
    return told if len(set(told)) == len(robots) else list(range(place, place + len(robots)))


def _read(bag: Bag, robot: BagRobot, number: int, asked: str | None) -> TagLog:
    if robot.unclear:
        raise ReaderError(bag.path, robot.unclear)
    cameras, wheels = set(robot.scans), robot.odometry[:1]
    tf, poses, base = Transforms(), [], ""
    told: list[tuple[float, list[Sighting]]] = []
    wrong = 0
    receiver = topics_of_fixes(bag.path, robot.fixes, bag.kinds, asked)
    fixed, antenna = [], ""
    for topic, ns, message in bag.messages({*cameras, *wheels, *robot.tf, *receiver}):
        if topic in receiver:
            fixed.append(fix_row(stamp(message.header, ns), message))
            antenna = antenna or frame(message.header.frame_id)
        elif topic in cameras:
            try:
                read = SIGHTINGS.get(bag.kinds[topic])
                told.append((stamp(message.header, ns), [] if read is None else list(read(message))))
            except DAMAGE:
                wrong += 1
        elif bag.kinds[topic] in TF:
            for transform in message.transforms:
                tf.add(stamp(transform.header, ns), transform)
        else:
            base = frame(message.child_frame_id)
            pose = planar(rigid(message.pose.pose.position, message.pose.pose.orientation))
            poses.append((stamp(message.header, ns), *pose))
    told += _frames_of_tags(tf, base)
    edge = tf.odometry_edge(frame(told[0][1][0].frame)) if told and told[0][1] else None
    if not poses and edge is not None:
        base, poses = edge[1], [(t, *planar(transform)) for t, transform in tf.seen[edge]]
    findings: list[Finding] = []
    t, at, names = _on_the_robot(told, tf, base, f"robot{number}", findings)
    seen = np.column_stack([t, np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])])
    dropped = {UNPACKABLE: bag.skipped + wrong, "transform that is not finite": tf.refused}
    fixes = read_fixes(fixed, receiver[0], bag.kinds[receiver[0]], antenna, tf, base) if receiver else None
    if receiver and bag.kinds[receiver[0]] in POSES:
        findings.append(positions_read(receiver[0], f"robot{number}"))
    return TagLog(
        number,
        velocities(np.array(poses, dtype=float).reshape(-1, 4)),
        seen,
        names,
        {reason: n for reason, n in dropped.items() if n},
        findings,
        _unused(bag, robot, told, receiver),
        fixes,
    )


def _frames_of_tags(tf: Transforms, base: str) -> list[tuple[float, list[Sighting]]]:
    """What transforms from a camera on the robot to frames of tags tell, moment by moment."""
    out: dict[float, list[Sighting]] = {}
    for (camera, child), rows in tf.seen.items():
        name = FRAME.search(child)
        if name is None or (base and base not in tf.chain(camera)):
            continue
        for t, (shift, _) in rows:
            out.setdefault(t, []).append(Sighting(str(int(name[1])), camera, shift))
    return sorted(out.items(), key=lambda row: row[0])


def _on_the_robot(
    told: Sequence[tuple[float, list[Sighting]]], tf: Transforms, base: str, robot: str, findings: list[Finding]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m 3"], list[str]]:
    """Stamps, places on the robot [m] and names of all sightings, a name once a frame."""
    mounts: dict[str, Rigid] = {}
    t, at, names, twice = [], [], [], dict[str, int]()
    for when, sightings in told:
        places: dict[str, list[np.ndarray]] = {}
        for one in sightings:
            camera = frame(one.frame)
            if camera not in mounts:
                mounts[camera] = _mount(tf, base, camera, robot, findings)
            shift, turn = mounts[camera]
            if (np.abs(one.at) < FARTHEST).all() and one.at.any() and one.name:
                places.setdefault(one.name, []).append(shift + rotation_matrix(turn) @ one.at)
        for name, each in places.items():
            if np.ptp(np.array(each), axis=0).max() > TWICE:
                twice[name] = twice.get(name, 0) + 1
                continue
            t.append(when)
            at.append(np.mean(each, axis=0))
            names.append(name)
    findings += [
        Finding("tag-twice", robot, None, {"name": name, "value": n}, "neither is used") for name, n in twice.items()
    ]
    return np.array(t), np.array(at).reshape(-1, 3), names


def _mount(tf: Transforms, base: str, camera: str, robot: str, findings: list[Finding]) -> Rigid:
    """`T_robot_camera`; where no transform tells it, the camera stands on the robot and looks ahead."""
    place = tf.rigid_pose(base, camera) if base else None
    if place is not None:
        return place
    what = f"no transform from {base or 'the robot'} to {camera or 'the camera'}"
    findings.append(Finding("sensor-unplaced", robot, value=what))
    return (np.zeros(3), OPTICAL) if "optical" in camera else NOWHERE


def velocities(poses: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "k 3"]:
    """Rows t [s], v [m/s], w [rad/s] that lead from each pose t, x, y, theta to the next by an arc; the last stays."""
    poses = poses[np.isfinite(poses).all(axis=1)]
    poses = poses[np.argsort(poses[:, 0], kind="stable")]
    poses = poses[np.append(np.diff(poses[:, 0]) > 0, True)] if len(poses) else poses
    if len(poses) < 2:
        return np.zeros((0, 3))
    dt = np.diff(poses[:, 0])
    step = se2.between(poses[:-1, 1:], poses[1:, 1:])
    half = 0.5 * step[:, 2]
    chord = step[:, 0] * np.cos(half) + step[:, 1] * np.sin(half)
    v, w = chord / np.sinc(half / np.pi) / dt, step[:, 2] / dt
    return np.column_stack([poses[:, 0], np.append(v, v[-1]), np.append(w, w[-1])])


def _transforms(bag: Bag) -> Transforms:
    tf = Transforms()
    for _, ns, message in bag.messages(set(bag.topics(*TF))):
        for transform in message.transforms:
            tf.add(ns * 1e-9, transform)
    return tf


def _unused(
    bag: Bag, robot: BagRobot, told: Sequence[tuple[float, list[Sighting]]], receiver: Sequence[str]
) -> list[Unused]:
    """The topics that say nothing to the map, and why."""
    out = []
    for topic, kind in sorted(bag.kinds.items()):
        n = bag.counts.get(topic, 0)
        if (
            not n
            or topic in {*robot.tf, *robot.odometry[:1], *receiver}
            or (topic in robot.scans and kind in SIGHTINGS)
        ):
            continue
        if kind == IMAGES:
            why = "corners in an image; the frames of tags in tf are read" if told else "no frame of a tag in tf"
        elif kind in SCANS:
            why = "landmarks are mapped (--method ekf); without it scans are"
        elif topic in robot.odometry:
            why = "another odometry is read"
        elif kind in FIXES:
            why = why_no_fixes(topic, kind, robot.fixes)
        elif kind in {*SIGHTINGS, ODOMETRY, *TF}:
            why = "of another robot"
        elif kind == "geometry_msgs/msg/PoseArray":
            why = "poses without names"
        else:
            why = "no reader for this type"
        out.append(Unused(str(bag.path), topic, kind, n, why))
    return out
