"""Ranges between radios, odometry and position fixes from ROS recordings.

Who ranged to whom: the last two names with a number in the topic (`/uwb/tof/n_2/n_3/distance`: n_2 and n_3), or one in
the topic and one in the message's `frame_id` (`/robot1/uwb` with `anchor7`). A radio is on the robot of its own name,
or of its own number where every robot's number is a radio's; a radio on no robot is a beacon. Fixes are of the robot
whose name stands in the topic's namespace, or whose number does where no two robots have one.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError, UsageError
from ..core.findings import Finding, Unused
from ..core.fixes import Fixes
from ..core.names import in_order
from ..core.records import Track
from ..ranges.network import RangeLog
from .bag import Bag, bag_hash, open_bag, stamp
from .bag_robots import FIXES, SCAN, TF
from .fixes import NAVSAT, POSES, fix_row, positions_read, read_fixes, topics_of_fixes, why_no_fixes
from .laser_logs import is_bag
from .mcap import Message, fix_message, header_message, message_type, nanoseconds, odometry_message, write_messages
from .transforms import Transforms, frame, planar, rigid

RANGE, ODOMETRY = "sensor_msgs/msg/Range", "nav_msgs/msg/Odometry"
NAME = re.compile(r"[A-Za-z]+[_-]?[0-9]+|[0-9]+")
CLOCKS = 1.0  # [s] by which headers of two topics may be off each other: beyond, all go by when they were recorded


def is_range_bag(path: Path, *, growing: bool = False) -> bool:
    """Whether `path` is a recording of ranges and odometry, without scans; of one that grows, without their topic."""
    if not is_bag(path):
        return False
    bag = open_bag(path, ())
    held = {bag.kinds[topic] for topic in bag.kinds if bag.counts.get(topic)}
    scans = bag.kinds.values() if growing else held
    return RANGE in held and ODOMETRY in held and SCAN not in scans


def read_range_bag(path: Path, radios: Mapping[str, str] | None = None, fixes: str | None = None) -> RangeLog:
    """Odometry of every robot, all ranges, and fixes of robots that have such.

    radios: radio -> the robot it is on, where names do not say it; fixes: topics that tell where robots were, by
    default satellites alone. Raises ReaderError where no topic names a pair, where it cannot be told which radio is on
    which robot, and for topics of fixes that are not there.
    """
    bag = open_bag(path, (RANGE, ODOMETRY, *TF, *FIXES))
    wheels = _odometry_topics(bag)
    topics = [topic for topic in bag.topics(RANGE) if bag.counts.get(topic)]
    own = _topics_of_receivers(bag, tuple(wheels.values()))
    receivers = {t: robot for robot, mine in own.items() for t in topics_of_fixes(path, mine, bag.kinds, fixes)}
    stamps: dict[str, list[tuple[float, float]]] = {topic: [] for topic in (*topics, *wheels, *receivers)}
    fixed: dict[str, list[tuple[float, ...] | str]] = {topic: [] for topic in receivers}
    poses: dict[str, list[tuple[float, float, float]]] = {topic: [] for topic in wheels}
    rows: list[_Row] = []
    # frames of robots, of radios and receivers
    tf, base, stands = Transforms(), dict[str, str](), dict[str, str]()
    mounts = bag.topics(*TF)
    for topic, ns, message in bag.messages({*topics, *wheels, *mounts, *receivers}):
        if topic in mounts:
            for transform in message.transforms:
                tf.add(stamp(transform.header, ns), transform)
            continue
        if topic in poses:
            base.setdefault(wheels[topic], frame(message.child_frame_id))
            poses[topic].append(planar(rigid(message.pose.pose.position, message.pose.pose.orientation)))
        elif topic in receivers:
            stands.setdefault(topic, frame(message.header.frame_id))
            fixed[topic].append(fix_row(len(stamps[topic]), message))
        else:
            a, b = _pair(path, topic, message.header.frame_id)
            stands.setdefault(a, frame(message.header.frame_id))
            rows.append(_Row(topic, a, b, len(stamps[topic]), float(message.range)))
        told = message.header.stamp
        stamps[topic].append((told.sec + told.nanosec * 1e-9, ns * 1e-9))
    clock, notes = _clock(stamps)
    bad = {topic: int((~np.isfinite(poses[topic])).any(axis=1).sum()) for topic in wheels if poses[topic]}
    tracks = {t: k for t in wheels if len(poses[t]) > 1 and len((k := _track(clock(t), poses[t])).t) > 1}
    tracks = {wheels[topic]: track for topic, track in tracks.items()}
    if not tracks or not rows:
        raise ReaderError(path, f"expected odometry and ranges, found {bag.listing() or 'no topics'}")
    robots, seen = sorted(tracks, key=in_order), sorted({r for row in rows for r in (row.a, row.b)}, key=in_order)
    on, note = _robots_of_radios(path, seen, robots, radios or {})
    names = tuple(dict.fromkeys([*robots, *(on.get(radio, radio) for radio in seen)]))
    place = {radio: names.index(on.get(radio, radio)) for radio in seen}
    t = {topic: clock(topic) for topic in topics}
    antennas = {
        robot: there[0][:2]
        for radio, robot in on.items()
        if radio in stands and (there := tf.rigid_pose(base[robot], stands[radio])) is not None
    }
    told_at = {
        robot: _fixes(clock(topic), fixed[topic], topic, bag.kinds[topic], stands[topic], tf, base[robot])
        for topic, robot in receivers.items()
        if robot in tracks and fixed[topic]
    }
    read = {*topics, *receivers, *(topic for topic in wheels if wheels[topic] in tracks), *(mounts if antennas else ())}
    unused = tuple(
        Unused(str(path), topic, kind, bag.counts[topic], _why(topic, kind, own))
        for topic, kind in sorted(bag.kinds.items())
        if bag.counts.get(topic) and topic not in read
    )
    findings = [*([note] if note else []), *notes]
    findings += [positions_read(topic, robot) for topic, robot in receivers.items() if bag.kinds[topic] in POSES]
    findings += [
        Finding("rows-impossible", wheels[topic], value={"value": n, "what": "odometry"})
        for topic, n in bad.items()
        if n
    ]
    if bag.lost:
        findings.append(Finding("log-short", value=f"{path.name}: {bag.lost}", action="they are used"))
    return RangeLog(
        tracks,
        names,
        np.array([place[row.a] for row in rows], np.int64),
        np.array([place[row.b] for row in rows], np.int64),
        np.array([t[row.topic][row.k] for row in rows]),
        np.array([row.z for row in rows]),
        antennas=antennas,
        fixes={robot: found for robot, found in told_at.items() if found is not None},
        source=str(path),
        log_hash=bag_hash(path),
        unused=unused,
        findings=tuple(findings),
        dropped={"message that cannot be unpacked": bag.skipped} if bag.skipped else {},
    )


class _Row(NamedTuple):
    """A range: the k-th message of its topic, between radios a and b."""

    topic: str
    a: str
    b: str
    k: int
    z: float


def _pair(path: Path, topic: str, frame: str) -> tuple[str, str]:
    names = NAME.findall(topic)[-2:]
    names = names if len(names) == 2 else [*names, *NAME.findall(frame)[-1:]]
    if len(names) != 2:
        there = f"{topic} in frame {frame!r}"
        raise ReaderError(path, f"expected who ranged to whom in the topic or frame_id (../n_2/n_3/..), found {there}")
    return names[0], names[1]


def _odometry_topics(bag: Bag) -> dict[str, str]:
    """Topic -> robot: the last name with a number in the namespace, else the namespace; of each robot the fullest."""
    out: dict[str, str] = {}
    for topic in bag.topics(ODOMETRY):
        space = topic.strip("/").split("/")[:-1]
        numbered = [word for word in space if NAME.fullmatch(word)]
        robot = numbered[-1] if numbered else "/".join(space) or "robot1"
        if bag.counts.get(topic) and robot not in out.values():
            out[topic] = robot
    return out


def _clock(
    stamps: Mapping[str, Sequence[tuple[float, float]]],
) -> tuple[Callable[[str], np.ndarray], list[Finding]]:
    """How to tell a topic's stamps: by headers where all are of one clock, else by when messages were recorded."""
    late = {topic: float(np.median([r - h for h, r in rows])) for topic, rows in stamps.items() if rows}
    whole = all(h > 0 for rows in stamps.values() for h, _ in rows)
    headers = whole and max(late.values(), default=0.0) - min(late.values(), default=0.0) < CLOCKS
    note = [] if headers or not late else [
        Finding("stamps-recorded", value="headers of the topics are of different clocks")
    ]  # fmt: skip
    return (lambda topic: np.array([row[0 if headers else 1] for row in stamps[topic]])), note


def _track(t: np.ndarray, poses: Sequence[tuple[float, float, float]]) -> Track:
    order = np.argsort(t, kind="stable")
    t, pose = t[order], np.array(poses)[order]
    keep = np.append(np.diff(t) > 0, True) & np.isfinite(pose).all(axis=1)
    return Track(t[keep], pose[keep], frame="odom")


def _robots_of_radios(
    path: Path, radios: Sequence[str], robots: Sequence[str], given: Mapping[str, str]
) -> tuple[dict[str, str], Finding | None]:
    """Which robot each radio is on, and what was assumed."""
    for radio, robot in given.items():
        if radio not in radios or robot not in robots:
            odd, there = (radio, radios) if radio not in radios else (robot, robots)
            raise UsageError(f"--radios: {path.name} knows no {odd}, only {', '.join(there)}")
    if given:
        return dict(given), None
    if set(robots) <= set(radios):
        return {robot: robot for robot in robots}, None
    number = {radio: int(re.findall(r"[0-9]+", radio)[-1]) for radio in radios}
    by_number = {number[radio]: radio for radio in radios}
    wanted = {robot: int(re.findall(r"[0-9]+", robot)[-1]) for robot in robots if re.search(r"[0-9]", robot)}
    if len(by_number) == len(radios) and len(wanted) == len(robots) and set(wanted.values()) <= set(by_number):
        on = {by_number[n]: robot for robot, n in wanted.items()}
    elif len(radios) == len(robots) == 2:
        on = dict(zip(radios, robots, strict=True))  # a range is the same either way
    else:
        raise ReaderError(
            path,
            f"cannot tell which of the radios {', '.join(radios)} is on which of the robots {', '.join(robots)}: say "
            "so by --radios RADIO=ROBOT,..",
        )
    told = ", ".join(f"{radio} on {robot}" for radio, robot in on.items())
    return on, Finding("radios-assumed", value=told)


def _topics_of_receivers(bag: Bag, robots: Sequence[str]) -> dict[str, list[str]]:
    """Robot -> topics of fixes on it, the fullest first."""
    number = {robot: int(told[-1]) for robot in robots if (told := re.findall(r"[0-9]+", robot))}
    out: dict[str, list[str]] = {robot: [] for robot in robots}
    for topic in bag.topics(*FIXES):
        inside = [robot for robot in robots if f"/{robot}/" in f"/{topic.strip('/')}"]
        named = {int(re.findall(r"[0-9]+", name)[-1]) for name in NAME.findall(topic)}
        alike = [robot for robot in robots if number.get(robot) in named]
        own = inside or (alike if len(set(number.values())) == len(robots) else []) or list(robots)
        if bag.counts.get(topic) and len(own) == 1:
            out[own[0]].append(topic)
    return out


def _fixes(
    t: Float[np.ndarray, " k"],
    rows: Sequence[tuple[float, ...] | str],
    topic: str,
    kind: str,
    header_frame: str,
    tf: Transforms,
    base: str,
) -> Fixes | None:
    """The fixes of a topic whose k-th message was at t[k]; rows: of `fix_row`, k in place of the time."""
    timed = [row if isinstance(row, str) else (float(t[int(row[0])]), *row[1:]) for row in rows]
    return read_fixes(timed, topic, kind, header_frame, tf, base)


def _why(topic: str, kind: str, receivers: Mapping[str, Sequence[str]]) -> str:
    if kind == ODOMETRY:
        return "fewer than two messages, or another odometry of the robot is read"
    if kind in FIXES:
        return why_no_fixes(topic, kind, [t for mine in receivers.values() for t in mine])
    return "no reader for this type"


def write_range_bag(
    path: Path,
    odometry: Mapping[str, Track],
    ranges: Sequence[tuple[str, str, np.ndarray, np.ndarray]],
    fixes: Mapping[str, Fixes] | None = None,
) -> None:
    """`path` is an MCAP recording of every robot's odometry and, for each pair (a, b, t [s], z [m]), its ranges.

    And of satellite fixes, of robots that have such.

    Names hold a number each, so that `read_range_bag` finds them again in the topics.
    """
    types = {f"/{robot}/odom": ODOMETRY for robot in odometry} | {_topic(a, b): RANGE for a, b, _, _ in ranges}
    types |= {f"/{robot}/fix": NAVSAT for robot in fixes or {}}

    def messages() -> Iterator[Message]:
        for robot, track in odometry.items():
            for t, pose in zip(track.t, track.pose, strict=True):
                yield nanoseconds(t), f"/{robot}/odom", odometry_message(nanoseconds(t), pose)
        for a, b, stamps, z in ranges:
            for t, metres in zip(stamps, z, strict=True):
                yield nanoseconds(t), _topic(a, b), _range_message(nanoseconds(t), a, float(metres))
        for robot, told in (fixes or {}).items():
            for t, place, cov in zip(told.t, told.place, told.cov, strict=True):
                yield nanoseconds(t), f"/{robot}/fix", fix_message(nanoseconds(t), place, cov)

    write_messages(path, types, messages(), ())


def _topic(a: str, b: str) -> str:
    return f"/uwb/{a}/{b}/range"


def _range_message(ns: int, frame: str, metres: float) -> Any:
    kind = message_type("sensor_msgs/msg/Range")
    return kind(
        header=header_message(ns, frame),
        radiation_type=0,
        field_of_view=0.0,
        min_range=0.0,
        max_range=0.0,
        range=metres,
    )
