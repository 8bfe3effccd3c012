"""ROS 1 and ROS 2 recordings as one thing: topics, and their messages in time order."""

import hashlib
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Bag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..core.errors import ReaderError
from .files import recording_suffix
from .salvage import DAMAGE, Salvage, check_chunks, salvage, with_header

Stamped = tuple[str, int, Any]  # topic, recording time [ns], message
STAMP = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
ANGLES, RANGES = ("angle_min", "angle_max", "angle_increment"), ("range_min", "range_max")
SCAN = attrgetter(*STAMP, *ANGLES, *RANGES, "time_increment", "scan_time", "ranges", "intensities")
NEEDED = {
    "sensor_msgs/msg/LaserScan": SCAN,
    "sensor_msgs/msg/MultiEchoLaserScan": SCAN,
    "sensor_msgs/msg/PointCloud2": attrgetter(
        *STAMP, "height", "width", "fields", "is_bigendian", "point_step", "row_step", "data"
    ),
    "sensor_msgs/msg/Imu": attrgetter(
        *STAMP,
        *(f"{what}.{name}" for what in ("angular_velocity", "linear_acceleration") for name in "xyz"),
        "linear_acceleration_covariance",
    ),
    "sensor_msgs/msg/NavSatFix": attrgetter(
        *STAMP,
        "status.status",
        "latitude",
        "longitude",
        "altitude",
        "position_covariance",
        "position_covariance_type",
    ),
    "geometry_msgs/msg/PoseStamped": attrgetter(*STAMP, *(f"pose.position.{name}" for name in "xyz")),
    "geometry_msgs/msg/PoseWithCovarianceStamped": attrgetter(
        *STAMP, *(f"pose.pose.position.{name}" for name in "xyz"), "pose.covariance"
    ),
    "nav_msgs/msg/Odometry": attrgetter(
        *STAMP,
        "child_frame_id",
        *(f"pose.pose.position.{name}" for name in "xyz"),
        *(f"pose.pose.orientation.{name}" for name in "xyzw"),
    ),
    "tf2_msgs/msg/TFMessage": attrgetter("transforms"),
    "tf/msg/tfMessage": attrgetter("transforms"),
    "transform": attrgetter(
        *STAMP,
        "child_frame_id",
        *(f"transform.translation.{name}" for name in "xyz"),
        *(f"transform.rotation.{name}" for name in "xyzw"),
    ),
}
# Of packages that ROS does not come with, for the recordings that hold no definitions (.db3 before ROS 2 Iron).
DEFINED = {
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\nPoint centre\nPoint[4] corners\nfloat64[9] homography",
    "apriltag_msgs/msg/AprilTagDetectionArray": "std_msgs/Header header\nAprilTagDetection[] detections",
    "ros2_aruco_interfaces/msg/ArucoMarkers": "std_msgs/Header header\nint64[] marker_ids\ngeometry_msgs/Pose[] poses",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
    "string id",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}
UNPACKABLE = "message that cannot be unpacked"
SUFFIXES = (".bag", ".mcap", ".db3")


@dataclass(slots=True)
class Bag:
    """kinds: the type of every topic; counts: its messages; lost: what could not be read, empty when all could;

    skipped: messages read over so far because they do not hold what their type says.
    """

    path: Path
    kinds: dict[str, str]
    counts: dict[str, int]
    lost: str
    skipped: int = 0
    _salvaged: Salvage | None = None

    def topics(self, *kinds: str) -> list[str]:
        """Topics of one of the `kinds`, the fullest first."""
        mine = [topic for topic, kind in self.kinds.items() if kind in kinds]
        return sorted(mine, key=lambda topic: (-self.counts.get(topic, 0), topic))

    def listing(self) -> str:
        return ", ".join(f"{t} ({self.kinds[t]}, {self.counts.get(t, 0)} messages)" for t in sorted(self.kinds))

    def messages(self, topics: Collection[str], once: Collection[str] = ()) -> Iterator[Stamped]:
        """The messages of `topics`, of those in `once` the first alone.

        The reading stops quietly at damage, and `lost` then says so.
        """
        self.skipped = 0
        done: set[str] = set()
        for topic, ns, message in self._raw(topics):
            if topic in done or topic not in topics:  # a damaged index gives messages of others too
                continue
            try:
                unpacked = message()
                _check(unpacked, self.kinds[topic])
            except DAMAGE:
                self.skipped += 1
                continue
            yield topic, ns, unpacked
            if topic in once:
                done.add(topic)

    def _raw(self, topics: Collection[str]) -> Iterator[tuple[str, int, Callable[[], Any]]]:
        """Topic, time and how to unpack each message."""
        if self._salvaged is not None:
            yield from _unpacked(self, self._salvaged, topics)
            return
        with _reader(self.path) as reader:
            wanted = [c for c in reader.connections if c.topic in topics]
            for connection, ns, data in reader.messages(connections=wanted) if wanted else ():
                yield connection.topic, ns, partial(reader.deserialize, data, connection.msgtype)


def known_types() -> Typestore:
    """The types of messages that are known without their definitions."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, text in DEFINED.items():
        store.register(get_types_from_msg(text, kind))
    return store


def open_bag(path: Path, kinds_read: Collection[str]) -> Bag:
    """The recording at `path` (a file, or a ROS 2 folder), of which topics of the types `kinds_read` will be read.

    Those are read through once, since a damaged middle shows only then. Raises ReaderError when nothing can be read.
    """
    path = _single(path)
    for part in [path] if path.is_file() else sorted(p for p in path.iterdir() if p.suffix in SUFFIXES):
        check_chunks(part)
    try:
        with _reader(path) as reader:
            kinds = _named({c.topic: c.msgtype for c in reader.connections})
            counts: Counter[str] = Counter()
            for c in reader.connections:
                counts[c.topic] += c.msgcount
            wanted = [c for c in reader.connections if c.msgtype in kinds_read]
            for _ in reader.messages(connections=wanted) if wanted else ():
                pass
    except DAMAGE as error:
        salvaged = salvage(path) if path.is_file() else Salvage()
        if not salvaged.messages:
            raise ReaderError(path, f"not a readable ROS recording: {_short(error)}") from None
        lost = f"cut short or damaged ({_short(error)}): {len(salvaged.messages)} messages could be read"
        counts = Counter(topic for topic, _, _ in salvaged.messages)
        return Bag(path, _named(salvaged.kinds), dict(counts), lost, _salvaged=salvaged)
    return Bag(path, kinds, dict(counts), "")


class _Bag1(Bag1):  # type: ignore[misc]
    """A ROS 1 recording of any year."""

    def read_connection(self) -> Connection:
        told = super().read_connection()
        return told._replace(msgdef=told.msgdef._replace(data=with_header(told.msgdef.data)))


@contextmanager
def _reader(path: Path) -> Iterator[AnyReader]:
    """Reads the recording at `path`, whose format is that of its content whatever it is called."""
    suffix = recording_suffix(path) if path.is_file() else path.suffix
    with tempfile.TemporaryDirectory() as folder:
        called = path
        if suffix and suffix != path.suffix:  # AnyReader goes by the suffix
            called = Path(folder) / f"recording{suffix}"
            try:
                called.symlink_to(path.resolve())
            except OSError:  # where links need a privilege
                shutil.copyfile(path, called)
        try:
            whole = AnyReader([called], default_typestore=known_types())
            if not whole.is2:
                whole.readers = [_Bag1(called)]
            with whole as reader:
                yield reader
        except DAMAGE as error:
            if called == path:
                raise
            raise OSError(str(error).replace(str(called), str(path))) from None


def _named(kinds: Mapping[Any, Any]) -> dict[str, str]:
    """Types by topic; a damaged database may hold something else in place of a name, and that is left out."""
    return {topic: kind for topic, kind in kinds.items() if isinstance(topic, str) and isinstance(kind, str)}


def _check(message: Any, kind: str) -> None:
    """Raises AttributeError for a message whose recorded type lacks what its name promises."""
    if kind in NEEDED:
        NEEDED[kind](message)
    for transform in getattr(message, "transforms", ()):
        NEEDED["transform"](transform)


def stamp(header: Any, recorded: int) -> float:
    """Header time [s]; that of the recording [ns] where the header has none."""
    ns = header.stamp.sec * 10**9 + header.stamp.nanosec
    return float((ns or recorded) / 1e9)


def bag_hash(path: Path) -> str:
    """SHA-256 over the recording's files."""
    digest = hashlib.sha256()
    for part in [path] if path.is_file() else sorted(p for p in path.iterdir() if p.suffix in SUFFIXES):
        digest.update(part.read_bytes())
    return digest.hexdigest()


def _single(path: Path) -> Path:
    """A folder without metadata but with one recording stands for that recording."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        inside = sorted(p for p in path.iterdir() if p.suffix in SUFFIXES)
        if len(inside) == 1:
            return inside[0]
        raise ReaderError(path, f"expected metadata.yaml or one recording, found {len(inside)} recordings")
    return path


def _unpacked(bag: Bag, salvaged: Salvage, topics: Collection[str]) -> Iterator[tuple[str, int, Callable[[], Any]]]:
    ros1 = recording_suffix(bag.path) == ".bag"
    store = get_typestore(Stores.EMPTY) if ros1 else known_types()
    for kind, text in salvaged.definitions.items():
        try:
            known = get_types_from_msg(text, kind)
            store.register({name: fields for name, fields in known.items() if name not in store.fielddefs})
        except DAMAGE:  # messages of this type cannot be unpacked, and are counted as such
            continue
    for topic, ns, data in salvaged.messages:
        if topic in topics:
            kind = bag.kinds[topic]
            yield topic, ns, partial(store.deserialize_ros1 if ros1 else store.deserialize_cdr, data, kind)


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120].rstrip(".") or type(error).__name__
