"""Laser logs from ROS recordings: one robot's scans and odometry found by type, sensor poses from tf."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.findings import Unused
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan, floats
from .bag import UNPACKABLE, Bag, bag_hash, open_bag, stamp
from .bag_robots import CLOUD, ECHOES, ODOMETRY, SCAN, SCANS, TF, BagRobot, bag_robots, choose_robot
from .clouds import cloud_scans
from .fixes import NAVSAT, POSES, fix_row, positions_read, read_fixes, topics_of_fixes, why_no_fixes
from .inertial import IMU, Inertial, imu_row
from .tags import TAGS
from .transforms import NOWHERE, Transforms, frame, planar, rigid, rotation_matrix

READ = (SCAN, ECHOES, ODOMETRY, IMU, NAVSAT, *TF)
CHOOSES = "this one is read with --scan-topic"
Stamped = tuple[float, str, Any]  # time [s], topic, LaserScan


def robots_in(path: Path) -> tuple[str, ...]:
    """The names of the robots in the recording at `path` that carry a scanner, in natural order."""
    return tuple(robot.name for robot in bag_robots(_opened(path, None)))


def read_ros(
    path: Path,
    robot: str,
    *,
    name: str | None = None,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    sensor_pose: Sequence[float] | None = None,
    mirrored: bool = False,
    height: Sequence[float] | None = None,
    fixes: str | None = None,
) -> LaserLog:
    """The log of the robot called `name` (or that the topics speak of, or the only one) in a recording.

    All its scanners that tf places are used, unless a topic is named; `odom_topic` may name a tf topic. Stamps are
    those of the message headers. height: what of point clouds is a scan, from [m] to [m] above the floor; fixes: topics
    that tell where the robot was, by default satellites alone. Raises
    ReaderError, listing what is there, for a topic that is not, and where several robots could be meant.
    """
    bag = _opened(path, scan_topic)
    chosen = choose_robot(bag, name, scan_topic, odom_topic)
    raw = RawLog(robot, str(path), _hash_of(bag_hash(path), chosen))
    if bag.lost:
        raw.find("log-short", f"{path.name}: {bag.lost}", "they are used")
    if len(chosen.odometry) > 1:
        wheels, *others = chosen.odometry
        raw.find("topics-chosen", f"odometry is read from {wheels}; there is also {', '.join(others)}")
    told = topics_of_fixes(path, chosen.fixes, bag.kinds, fixes)
    seen = _gathered(bag, chosen, raw, told)
    base = _with_odometry_from_tf(seen, chosen, raw)
    given = sensor_pose is not None
    used = _placed(seen.frames, bag, chosen.scans, seen.tf, base, raw, given=given)
    _add_scans(raw, [m for m in seen.scans if m[1] in used], seen.tf, base, given=given)
    for topic in (topic for topic in chosen.scans if topic in used and bag.kinds[topic] == CLOUD):
        raw.scans += cloud_scans(bag, topic, seen.tf, base, height, raw, given=given)
    if seen.imu:
        topic = chosen.imu[0]
        place = seen.tf.rigid_pose(base, seen.frames[topic]) or NOWHERE
        raw.inertial = Inertial(topic, floats(sorted(seen.imu)), rotation_matrix(place[1])[2])
    if told:
        kind = bag.kinds[told[0]]
        raw.fixes = read_fixes(seen.fixes, told[0], kind, seen.frames.get(told[0], ""), seen.tf, base)
        if kind in POSES:
            raw.findings.append(positions_read(told[0], robot))
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _opened(path: Path, scan_topic: str | None) -> Bag:
    """The recording, of which point clouds, which are large, are looked through only where they will be read."""
    bag = open_bag(path, READ)
    clouds = [topic.lstrip("/") for topic in bag.topics(CLOUD)]
    aside = bag.topics(SCAN, ECHOES) and (scan_topic or "").lstrip("/") not in clouds
    return bag if aside or not clouds else open_bag(path, (*READ, CLOUD))


@dataclass(slots=True)
class _Gathered:
    """Of one robot's topics, point clouds aside. frames: of scan topics; base: the robot's frame, how often told."""

    scans: list[Stamped] = field(default_factory=list)
    frames: dict[str, str] = field(default_factory=dict)
    tf: Transforms = field(default_factory=Transforms)
    imu: list[tuple[float, ...]] = field(default_factory=list)
    fixes: list[tuple[float, ...] | str] = field(default_factory=list)
    base: Counter[str] = field(default_factory=Counter)


def _gathered(bag: Bag, chosen: BagRobot, raw: RawLog, fixes: Sequence[str]) -> _Gathered:
    """What the recording holds of a robot; its odometry messages, and what could not be read, are put into `raw`."""
    out = _Gathered()
    wanted = {*chosen.scans, *chosen.tf, *chosen.odometry[:1], *chosen.imu[:1], *fixes}
    clouds = {topic for topic in chosen.scans if bag.kinds[topic] == CLOUD}
    for topic, _, message in bag.messages(clouds, once=clouds) if clouds else ():
        out.frames[topic] = frame(message.header.frame_id)
    for topic, ns, message in bag.messages(wanted - clouds):
        if topic in chosen.scans:
            out.scans.append((stamp(message.header, ns), topic, message))
            out.frames.setdefault(topic, frame(message.header.frame_id))
        elif bag.kinds[topic] in TF:
            for transform in message.transforms:
                out.tf.add(stamp(transform.header, ns), transform)
        elif topic in chosen.imu:
            out.imu.append(imu_row(stamp(message.header, ns), message))
            out.frames.setdefault(topic, frame(message.header.frame_id))
        elif topic in fixes:
            out.fixes.append(fix_row(stamp(message.header, ns), message))
            out.frames.setdefault(topic, frame(message.header.frame_id))
        else:
            pose = planar(rigid(message.pose.pose.position, message.pose.pose.orientation))
            raw.odometry.append((stamp(message.header, ns), *pose))
            out.base[frame(message.child_frame_id)] += 1
            raw.odometry_from = "poses"
    raw.unused = _unused(bag, wanted, chosen)
    raw.dropped.update(+Counter({UNPACKABLE: bag.skipped, "transform that is not finite": out.tf.refused}))
    return out


def _with_odometry_from_tf(seen: _Gathered, chosen: BagRobot, raw: RawLog) -> str:
    """The robot's frame; `raw` has the odometry of tf where no message told any.

    That of the only robot of a recording is read also where no transform places its scanner.
    """
    above = ((topic, seen.tf.odometry_edge(seen.frames.get(topic, ""))) for topic in chosen.scans)
    topic, edge = next((found for found in above if found[1] is not None), (chosen.scans[0], None))
    if edge is None and chosen.alone:
        edge = seen.tf.only_odometry_edge()
    if not raw.odometry and edge is not None and not (set(chosen.odometry[:1]) - set(chosen.tf)):
        way = seen.tf.travelled(edge, seen.frames.get(topic, ""))
        raw.odometry = seen.tf.poses_along(way)
        raw.odometry_from = "tf"
        return way[-1][1]
    return seen.base.most_common(1)[0][0] if seen.base else (edge[1] if edge else "")


def _first_echoes(values: Any) -> np.ndarray:
    """Of every beam what came back first, as numbers; NaN where nothing did."""
    if len(values) and hasattr(values[0], "echoes"):
        return floats([echo.echoes[0] if len(echo.echoes) else np.nan for echo in values])
    return floats(values)


def _unused(bag: Bag, read: set[str], chosen: BagRobot) -> list[Unused]:
    """The topics of the recording that say nothing to the map, and why."""
    out = []
    for topic, kind in sorted(bag.kinds.items()):
        if topic in read or not bag.counts.get(topic):
            continue
        if kind in TAGS:
            why = "landmarks; --method ekf maps them"
        elif kind in {NAVSAT, *POSES}:
            why = why_no_fixes(topic, kind, chosen.fixes)
        elif kind not in {*SCANS, ODOMETRY, IMU, *TF}:
            why = "no reader for this type"
        elif kind == IMU:
            why = f"{chosen.imu[0]} is read" if topic in chosen.imu else "of another robot, or it is not told of which"
        elif topic in chosen.odometry:
            why = f"another odometry is read; --odom-topic {topic} reads this one"
        elif kind == CLOUD and CLOUD not in {bag.kinds[scan] for scan in chosen.scans}:
            why = f"scans are read instead; {CHOOSES} {topic}"
        else:
            why = "of another robot, or not chosen"
        out.append(Unused(str(bag.path), topic, kind, bag.counts[topic], why))
    return out


def _hash_of(digest: str, robot: BagRobot) -> str:
    """The recording's hash; that of a named robot's part of it differs from the other robots'."""
    return hashlib.sha256(f"{digest} {robot.name}".encode()).hexdigest() if robot.name else digest


def _placed(
    frames: dict[str, str], bag: Bag, scans: Sequence[str], tf: Transforms, base: str, raw: RawLog, *, given: bool
) -> set[str]:
    """The scan topics to use: all that tf places on the robot, one of each frame; else the first of all.

    What is told in the robot's own frame, on which other scanners hang, was computed of their scans: none of those.
    """
    found = {topic: tf.sensor_pose(base, frames[topic]) for topic in scans if topic in frames}
    at = {topic: pose[0] for topic, pose in found.items() if pose is not None}
    hung = {above for topic in at for above in tf.chain(frames[topic])[1:]}
    placed = [topic for topic, pose in at.items() if pose.any() or frames[topic] not in hung]
    used: dict[str, str] = {}
    for topic in placed[:1] if given else placed:
        used.setdefault(frames[topic], topic)
    kept = list(used.values()) or list(scans[:1])
    why = "not placed by tf, computed, or the same scanner as another topic" if placed else "another scanner is read"
    for topic in (t for t in scans if t not in kept):
        raw.unused.append(Unused(raw.source, topic, bag.kinds[topic], bag.counts[topic], f"{why}; {CHOOSES} {topic}"))
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
        ranges, light = (_first_echoes(values) for values in (message.ranges, message.intensities))
        step = message.angle_increment or (message.angle_max - message.angle_min) / max(1, n - 1)
        raw.scans.append(
            RawScan(
                t,
                ranges,
                light if len(light) else None,
                sign * float(message.angle_min),
                sign * float(step),
                float(message.range_min),
                float(message.range_max) if message.range_max > 0 else np.inf,
                pose,
                sweep=float(message.time_increment) * (n - 1),
            )
        )
