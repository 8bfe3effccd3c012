"""Laser logs from ROS recordings: one robot's scans and odometry found by type, sensor poses from tf."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.findings import Unused
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan, floats
from .bag import Bag, bag_hash, open_bag
from .bag_robots import ODOMETRY, SCAN, TF, BagRobot, bag_robots, choose_robot
from .transforms import Transforms, frame, planar, rigid

Stamped = tuple[float, str, Any]  # time [s], topic, LaserScan


def robots_in(path: Path) -> tuple[str, ...]:
    """The names of the robots in the recording at `path` that carry a scanner, in natural order."""
    return tuple(robot.name for robot in bag_robots(open_bag(path, (SCAN, ODOMETRY, *TF))))


def read_ros(
    path: Path,
    robot: str,
    *,
    name: str | None = None,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    sensor_pose: Sequence[float] | None = None,
    mirrored: bool = False,
) -> LaserLog:
    """The log of the robot called `name` (or that the topics speak of, or the only one) in a recording.

    All its scanners that tf places are used, unless a topic is named; `odom_topic` may name a tf topic. Stamps are
    those of the message headers. Raises ReaderError, listing what is there, for a topic that is not, and where several
    robots could be meant.
    """
    bag = open_bag(path, (SCAN, ODOMETRY, *TF))
    chosen = choose_robot(bag, name, scan_topic, odom_topic)
    raw = RawLog(robot, str(path), _hash_of(bag_hash(path), chosen))
    if bag.lost:
        raw.find("log-short", f"{path.name}: {bag.lost}", "they are used")
    wheels = chosen.odometry[0] if chosen.odometry else None
    if len(chosen.odometry) > 1:
        raw.find("topics-chosen", f"odometry is read from {wheels}; there is also {', '.join(chosen.odometry[1:])}")
    by_tf = wheels is not None and bag.kinds[wheels] in TF
    tf = Transforms()
    messages: list[Stamped] = []
    robot_frame: Counter[str] = Counter()
    for topic, ns, message in bag.messages({*chosen.scans, *chosen.tf, *([wheels] if wheels else [])}):
        if topic in chosen.scans:
            messages.append((_stamp(message.header, ns), topic, message))
        elif bag.kinds[topic] in TF:
            for transform in message.transforms:
                tf.add(_stamp(transform.header, ns), transform)
        else:
            pose = planar(rigid(message.pose.pose.position, message.pose.pose.orientation))
            raw.odometry.append((_stamp(message.header, ns), *pose))
            robot_frame[frame(message.child_frame_id)] += 1
            raw.odometry_from = "poses"
    raw.unused = _unused(bag, {*chosen.scans, *chosen.tf, *([wheels] if wheels else [])}, chosen)
    if bag.skipped:
        raw.dropped["message that cannot be unpacked"] += bag.skipped
    if tf.refused:
        raw.dropped["transform that is not finite"] += tf.refused
    sensor = next((frame(m.header.frame_id) for _, topic, m in messages if topic == chosen.scans[0]), "")
    edge = tf.odometry_edge(sensor)
    if not raw.odometry and edge is not None and (wheels is None or by_tf):
        raw.odometry = [(t, *planar(transform)) for t, transform in tf.seen[edge]]
        raw.odometry_from = "tf"
        robot_frame[edge[1]] += 1
    base = robot_frame.most_common(1)[0][0] if robot_frame else (edge[1] if edge else "")
    used = _placed(messages, chosen.scans, tf, base, raw, given=sensor_pose is not None)
    _add_scans(raw, [m for m in messages if m[1] in used], tf, base, given=sensor_pose is not None)
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _unused(bag: Bag, read: set[str], chosen: BagRobot) -> list[Unused]:
    """The topics of the recording that say nothing to the map, and why."""
    out = []
    for topic, kind in sorted(bag.kinds.items()):
        if topic in read or not bag.counts.get(topic):
            continue
        if kind not in {SCAN, ODOMETRY, *TF}:
            why = "no reader for this type"
        elif topic in chosen.odometry:
            why = "another odometry is read"
        else:
            why = "of another robot, or not chosen"
        out.append(Unused(str(bag.path), topic, kind, bag.counts[topic], why))
    return out


def _hash_of(digest: str, robot: BagRobot) -> str:
    """The recording's hash; that of a named robot's part of it differs from the other robots'."""
    return hashlib.sha256(f"{digest} {robot.name}".encode()).hexdigest() if robot.name else digest


def _placed(
    messages: Sequence[Stamped], scans: Sequence[str], tf: Transforms, base: str, raw: RawLog, *, given: bool
) -> set[str]:
    """The scan topics to use: all that tf places on the robot, one of each frame; else the first of all."""
    frames: dict[str, str] = {}
    for _, topic, message in messages:
        frames.setdefault(topic, frame(message.header.frame_id))
    placed = [topic for topic in scans if topic in frames and tf.sensor_pose(base, frames[topic]) is not None]
    used: dict[str, str] = {}
    for topic in placed[:1] if given else placed:
        used.setdefault(frames[topic], topic)
    kept = list(used.values()) or list(scans[:1])
    why = "not placed by tf, or the same scanner as another topic" if placed else "another scanner is read"
    for topic in (t for t in scans if t not in kept):
        seen = sum(1 for _, other, _ in messages if other == topic)
        raw.unused.append(Unused(raw.source, topic, SCAN, seen, why))
    if left := [topic for topic in scans if topic not in kept]:
        raw.find("topics-chosen", f"scan is read from {' and '.join(kept)}; there is also {', '.join(left)}")
    elif len(kept) > 1:
        raw.find("topics-chosen", f"scans of {' and '.join(kept)} are used together")
    return set(kept)


def _add_scans(raw: RawLog, messages: Sequence[Stamped], tf: Transforms, base: str, *, given: bool) -> None:
    places: dict[str, tuple[np.ndarray, bool]] = {}
    stated = [float(m.scan_time) for _, _, m in messages if m.scan_time > 0]
    raw.scan_time = float(np.median(stated)) if stated else None
    for t, _, message in messages:
        name = frame(message.header.frame_id)
        if name not in places:
            place = tf.sensor_pose(base, name)
            if place is None:
                place = np.zeros(3), False
                if not given:
                    raw.find("sensor-unplaced", f"no transform from {base or 'the robot'} to {name or 'the laser'}")
            places[name] = place
        pose, upside_down = places[name]
        n, sign = len(message.ranges), -1.0 if upside_down else 1.0
        step = message.angle_increment or (message.angle_max - message.angle_min) / max(1, n - 1)
        light = floats(message.intensities)
        raw.scans.append(
            RawScan(
                t,
                floats(message.ranges),
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
