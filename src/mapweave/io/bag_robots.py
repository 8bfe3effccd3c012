"""Which topics of a recording speak of the same robot: told by namespace, by frame and by tf."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from ..core.errors import ReaderError
from ..core.names import in_order
from .bag import Bag
from .inertial import IMU
from .transforms import Transforms, frame

SCAN, ECHOES, CLOUD = (f"sensor_msgs/msg/{kind}" for kind in ("LaserScan", "MultiEchoLaserScan", "PointCloud2"))
SCANS = (SCAN, ECHOES, CLOUD)
FIXES = (
    "sensor_msgs/msg/NavSatFix",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
)
ODOMETRY = "nav_msgs/msg/Odometry"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

Place = tuple[str, ...]  # namespaces of a topic or frame, the outermost first
STEM = re.compile(r"scan|laser|lidar|odometry|odom", re.IGNORECASE)
CHOOSE = "choose with --scan-topic and --odom-topic"


@dataclass(frozen=True, slots=True)
class BagRobot:
    """One robot of a recording; its topics, the best first.

    name: its namespace, empty where there is none; unclear: why its odometry cannot be told, empty where it can;
    alone: whether the recording tells of no other.
    """

    name: str
    scans: tuple[str, ...]
    odometry: tuple[str, ...]
    tf: tuple[str, ...]
    unclear: str = ""
    imu: tuple[str, ...] = ()
    fixes: tuple[str, ...] = ()
    alone: bool = False


@dataclass(slots=True)
class _Topics:
    """frames: of each scan topic the sensor's, of each odometry topic the robot's; tf: transforms of each tf topic."""

    frames: dict[str, str] = field(default_factory=dict)
    tf: dict[str, Transforms] = field(default_factory=dict)

    def tree(self, topics: Iterable[str]) -> Transforms:
        whole = Transforms()
        for topic in topics:
            for edge, rows in self.tf.get(topic, Transforms()).seen.items():
                whole.seen.setdefault(edge, []).extend(rows)
        return whole


def bag_robots(bag: Bag, sensors: Sequence[str] = ()) -> tuple[BagRobot, ...]:
    """The robots of `bag` that carry a scanner, or sensors of these types, in the natural order of their names.

    Topics of one namespace belong together; within a namespace tf decides, then the frames' own namespaces. Point
    clouds are scans where nothing else is one.
    """
    kinds = sensors or ((SCAN, ECHOES) if bag.topics(SCAN, ECHOES) else (CLOUD,))
    scans = [topic for topic in bag.topics(*kinds) if bag.counts.get(topic)]
    odometry = [topic for topic in bag.topics(ODOMETRY) if bag.counts.get(topic)]
    tf = bag.topics(*TF)
    imu = [topic for topic in bag.topics(IMU) if bag.counts.get(topic)]
    fixes = [topic for topic in bag.topics(*FIXES) if bag.counts.get(topic)]
    if len(scans) <= 1 and len(odometry) <= 1:
        only = BagRobot("", tuple(scans), tuple(odometry), tuple(tf), imu=tuple(imu), fixes=tuple(fixes), alone=True)
        return (only,) if scans else ()
    seen = _frames_and_transforms(bag, scans, odometry, tf)
    homes = {topic: _home(topic, (*odometry, *tf)) for topic in scans}
    trees = {home: _near(home, tf, set(homes.values())) for home in set(homes.values())}
    groups = _grouped(scans, homes, seen, trees, odometry)
    robots = []
    for group in groups:
        home = homes[group[0]]
        rivals = [other for other in groups if homes[other[0]] == home]
        mine, unclear = _odometry_of(group, rivals, home, odometry, set(homes.values()), seen, trees[home])
        own, told = (
            tuple(t for t in topics if len(rivals) == 1 and _owner(t, homes.values()) == home)
            for topics in (imu, fixes)
        )
        name = _name(group, home, rivals, seen)
        robots.append(BagRobot(name, tuple(group), mine, tuple(trees[home]), unclear, own, told, len(groups) == 1))
    names = [robot.name for robot in robots]
    robots = [replace(r, name=r.scans[0].strip("/")) if names.count(r.name) > 1 else r for r in robots]
    return tuple(sorted(robots, key=lambda robot: (in_order(robot.name), robot.scans)))


def choose_robot(bag: Bag, name: str | None, scan_topic: str | None, odom_topic: str | None) -> BagRobot:
    """The robot called `name`, or the one that the topics given by hand speak of, or the only one.

    Raises ReaderError, listing what is there, for a topic that is not, and where several robots could be meant.
    """
    scan = None if scan_topic is None else _topic(bag, scan_topic, SCANS, "scan")
    wheels = None if odom_topic is None else _topic(bag, odom_topic, (ODOMETRY, *TF), "odometry")
    robots = bag_robots(bag)
    if not robots:
        raise ReaderError(bag.path, f"no message of LaserScan or PointCloud2; there are {bag.listing() or 'no topics'}")
    if name is not None:
        robots = tuple(robot for robot in robots if robot.name == name)
    if scan is not None:
        robots = tuple(replace(robot, scans=(scan,)) for robot in robots if scan in robot.scans) or (
            BagRobot("", (scan,), (), tuple(bag.topics(*TF))),
        )
    if wheels is not None:
        fits = [r for r in robots if wheels in (*r.odometry, *r.tf)] if len(robots) > 1 else robots
        robots = tuple(replace(robot, odometry=(wheels,), unclear="") for robot in fits)
    if len(robots) != 1:
        there = ", ".join(f"{r.name or 'one without a name'} ({r.scans[0]})" for r in bag_robots(bag))
        raise ReaderError(bag.path, f"expected one robot, found {there}; {CHOOSE}")
    if robots[0].unclear:
        raise ReaderError(bag.path, robots[0].unclear)
    return robots[0]


def _topic(bag: Bag, wanted: str, kinds: Sequence[str], what: str) -> str:
    for topic in bag.topics(*kinds):
        if topic.lstrip("/") == wanted.lstrip("/"):
            return topic
    raise ReaderError(bag.path, f"no {what} topic {wanted!r}; there are {bag.listing() or 'no topics'}")


def _frames_and_transforms(bag: Bag, scans: Sequence[str], odometry: Sequence[str], tf: Sequence[str]) -> _Topics:
    seen = _Topics(tf={topic: Transforms() for topic in tf})
    for topic, ns, message in bag.messages({*scans, *odometry, *tf}, once={*scans, *odometry}):
        if topic in seen.tf:
            for transform in message.transforms:
                seen.tf[topic].add(ns * 1e-9, transform)
        elif topic in scans:
            seen.frames[topic] = frame(message.header.frame_id)
        else:
            seen.frames[topic] = frame(message.child_frame_id)
    return seen


def _namespace(topic: str) -> Place:
    return tuple(topic.strip("/").split("/")[:-1])


def _place(topic: str) -> Place:
    """The namespaces of a topic; a numbered word of its last part (`robot1_scan`, `odom_2`) counts as one too."""
    last = topic.strip("/").split("/")[-1]
    words = [STEM.sub("", word) for word in re.split(r"[_\-]", last) if any(map(str.isdigit, word))]
    return _namespace(topic) + tuple(word for word in words[:1] if word)


def _frame_space(name: str) -> Place:
    """The robot a frame's name tells: `robot1` of `robot1/laser` and `robot1_laser`; none of `laser_2`."""
    if "/" in name:
        return _namespace(name)
    return tuple(word for word in _place(name) if not word.isdigit()) if "_" in name else ()


def _home(topic: str, others: Iterable[str]) -> Place:
    """The deepest namespace of a scan topic that holds odometry or transforms too."""
    place = _place(topic)
    about = [_place(other) for other in others]
    return next((place[:n] for n in range(len(place), 0, -1) if any(p[:n] == place[:n] for p in about)), ())


def _owner(topic: str, homes: Iterable[Place]) -> Place:
    """The deepest of `homes` that holds `topic`; the outermost namespace where none does."""
    place = _place(topic)
    return max((home for home in homes if place[: len(home)] == home), key=len, default=())


def _near(home: Place, tf: Iterable[str], homes: Iterable[Place]) -> list[str]:
    """The tf topics that speak of robots at `home`: its own, and those of the namespaces around it."""
    spaces = {topic: _namespace(topic) for topic in tf}
    return [t for t, space in spaces.items() if home[: len(space)] == space or _owner(t, homes) == home]


def _grouped(
    scans: Sequence[str], homes: dict[str, Place], seen: _Topics, trees: dict[Place, list[str]], odometry: Sequence[str]
) -> list[list[str]]:
    """Scan topics of one robot together, the fullest first."""
    groups: list[list[str]] = []
    for topic in scans:
        mates = [g for g in groups if any(_same(topic, other, homes, seen, trees, odometry) for other in g)]
        merged = [t for g in mates for t in g] + [topic]
        groups = [g for g in groups if g not in mates] + [merged]
    return groups


def _same(
    a: str, b: str, homes: dict[str, Place], seen: _Topics, trees: dict[Place, list[str]], odometry: Sequence[str]
) -> bool:
    """Whether two scan topics come from one robot."""
    one, two = homes[a], homes[b]
    here, there = seen.frames.get(a, ""), seen.frames.get(b, "")
    tree = seen.tree(dict.fromkeys([*trees[one], *trees[two]]))
    if one != two:
        nested = one[: len(two)] == two or two[: len(one)] == one
        return nested and here != there and _joined(tree, here, there) is True
    if here == there:
        return not _numbered(_namespace(a), _namespace(b))
    joined = _joined(tree, here, there)
    if joined is not None:
        return joined
    if _numbered(_frame_space(here), _frame_space(there)):
        return False
    if any(_owner(topic, homes.values()) == one for topic in odometry):
        return True
    return _namespace(a) == _namespace(b)


def _joined(tree: Transforms, a: str, b: str) -> bool | None:
    """Whether tf carries both frames on one robot; None where it does not say."""
    edges = tree.odometry_edge(a), tree.odometry_edge(b)
    if edges[0] is not None and edges[1] is not None:
        return edges[0] == edges[1]
    return True if set(tree.chain(a)) & set(tree.chain(b)) else None


def _numbered(a: Place, b: Place) -> bool:
    """Whether two namespaces differ, and in numbers alone: `robot1` and `robot2`."""
    patterns = [tuple(re.sub(r"[0-9]+", "#", word) for word in place) for place in (a, b)]
    return a != b and patterns[0] == patterns[1]


def _odometry_of(
    group: Sequence[str],
    rivals: Sequence[Sequence[str]],
    home: Place,
    odometry: Sequence[str],
    homes: set[Place],
    seen: _Topics,
    tf: Sequence[str],
) -> tuple[tuple[str, ...], str]:
    """The odometry topics that may be a group's, the best first; and why it cannot be told which, where it cannot."""
    tree = seen.tree(tf)
    mine: list[tuple[tuple[int, int], str]] = []
    for topic in odometry:
        if _owner(topic, homes) != home:
            continue
        speaks = {tuple(other): _evidence(topic, other, seen, tree) for other in rivals}
        own = speaks.pop(tuple(group))
        best = max(speaks.values(), default=(-2, 0))
        if own == best and len(rivals) > 1:
            also = next(other[0] for other, said in speaks.items() if said == best)
            return (), f"{topic} may be the odometry of {group[0]} or of {also}; {CHOOSE}"
        if own > best and own[0] >= 0:
            mine.append((own, topic))
    if not mine and len(rivals) > 1:
        edge = tree.odometry_edge(seen.frames.get(group[0], ""))
        also = next((o[0] for o in rivals if o is not group and seen.frames.get(o[0]) == seen.frames.get(group[0])), "")
        if edge is not None and also:
            return (), f"tf may tell the odometry of {group[0]} or of {also}: their frames are called alike; {CHOOSE}"
    mine.sort(key=lambda pair: (-pair[0][0], -pair[0][1]))
    return tuple(topic for _, topic in mine), ""


def _evidence(topic: str, group: Sequence[str], seen: _Topics, tree: Transforms) -> tuple[int, int]:
    """Whether odometry and scans are of one robot (1), of two (-1) or it is not said (0); and how much names agree."""
    place = _place(topic)
    said, shared = [], []
    for scan in group:
        said.append(_linked(tree, seen.frames.get(scan, ""), seen.frames.get(topic, "")))
        shared.append(sum(a == b for a, b in zip(place, _place(scan), strict=False)))
    return max(said), max(shared)


def _linked(tree: Transforms, sensor: str, base: str) -> int:
    """What tf says, and where it is silent the frames' names: 1 for one robot, -1 for two, 0 for nothing."""
    if base in tree.chain(sensor) or sensor in tree.chain(base):
        return 1
    if _joined(tree, sensor, base) is False:
        return -1
    spaces = _frame_space(sensor), _frame_space(base)
    if all(spaces) and _numbered(*spaces):
        return -1
    return int(all(spaces) and spaces[0] == spaces[1])


def _name(group: Sequence[str], home: Place, rivals: Sequence[Sequence[str]], seen: _Topics) -> str:
    if home and len(rivals) == 1:
        return "/".join(home)
    return "/".join(_frame_space(seen.frames.get(group[0], "")) or _namespace(group[0]) or home)
