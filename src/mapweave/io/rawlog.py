"""MRPT's `.rawlog`: scans, odometry and ranges to beacons, as its classes write themselves, plain or packed.

An object is its class's name, a version and its fields, without a length: those between which others stand that are
not read here are found by the names of the classes that are.
"""

import hashlib
import re
import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import ReaderError
from ..core.findings import Finding, Unused
from ..core.laser_log import LaserLog
from ..core.records import Track
from ..ranges.network import RangeLog
from .assemble import RawLog, RawScan
from .files import unpacked

SPACE = rb"(?:mrpt::\w{1,12}::)?"
NAME = re.compile(SPACE + rb"C(?:Observation\w+|SensoryFrame|Action\w+|Pose\w+|Point\w+|Matrix\w+)")
STANDING = re.compile(rb"([\x80-\xf8]|[\x01-\x78]\0\0\0)(?=" + SPACE + rb"C(?:Observation\w|SensoryFrame|Action\w))")
END = 0x88  # after an object
LONGEST_NAME = 120  # characters of a class
EPOCH = 11_644_473_600.0  # [s] from 1601, which stamps count from, to 1970
TICK = 1e-7  # [s] of a stamp
LEVEL = float(np.cos(np.radians(10.0)))  # of a scanner's upright against the robot's, at least
NOT_LEVEL = "scanner not level"
LATEST = {  # version of each class that is read, at most
    "CObservation2DRangeScan": 8,
    "CObservationOdometry": 2,
    "CObservationBeaconRanges": 3,
    "CSensoryFrame": 2,
    "CActionCollection": 0,
    "CActionRobotMovement2D": 7,
    "CPose2D": 1,
    "CPose3D": 3,
    "CPoint3D": 1,
    "CMatrixD": 0,
    "CMatrixF": 0,
    "CMatrix": 0,
    "CPosePDFGaussian": 2,
}


class BeaconRange(NamedTuple):
    """At t [s] beacon `beacon` was z [m] from the antenna, which stands at (2,) [m] on the robot."""

    t: float
    beacon: str
    z: float
    antenna: Float[np.ndarray, "2"]


@dataclass(slots=True)
class Rawlog:
    """What a file holds, in its order. odometry: t [s], x, y [m], theta [rad]; scans: with the odometry's pose where it
    is told from one to the next; others: class -> how many are not read; lost: what was lost where it ends too soon.
    """

    path: Path
    log_hash: str
    scans: list[RawScan] = field(default_factory=list)
    odometry: list[tuple[float, float, float, float]] = field(default_factory=list)
    ranges: list[BeaconRange] = field(default_factory=list)
    others: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    lost: str = ""

    def unused(self, *, ranges: bool) -> list[Unused]:
        """What of it is not used; ranges: whether those are."""
        left = dict(self.others)
        if not ranges and self.ranges:
            left["CObservationBeaconRanges"] = len(self.ranges)
        ranged = "ranges beside scans: ranges of a log without scans make a map"
        return [
            Unused(str(self.path), name, name, n, ranged if name == "CObservationBeaconRanges" else "it is not read")
            for name, n in sorted(left.items())
        ]


def is_rawlog(path: Path) -> bool:
    """Whether the file at `path` begins as a rawlog does."""
    try:
        with path.open("rb") as file:
            start, _ = unpacked(path, file.read(1 << 16))
    except (OSError, ReaderError, MemoryError):
        return False
    found = STANDING.match(bytes(start[: LONGEST_NAME + 4]))
    return found is not None


def read_rawlog(path: Path) -> Rawlog:
    """What the file at `path` holds. Raises ReaderError for one that is damaged, with the byte it is damaged at."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror}") from None
    data, short = unpacked(path, raw)
    log = Rawlog(path, hashlib.sha256(raw).hexdigest(), lost=short)
    _Reading(log, bytes(data)).whole()
    return log


def read_rawlog_scans(
    path: Path, robot: str, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The scans and odometry of the file at `path` as robot `robot`."""
    held = read_rawlog(path)
    raw = RawLog(robot, str(path), held.log_hash, held.scans, held.odometry)
    raw.odometry_from = "poses" if held.odometry else "none"
    raw.dropped.update(held.dropped)
    raw.unused = held.unused(ranges=False)
    if held.lost:
        raw.find("log-short", f"{path.name}: {held.lost}", "what was readable is used")
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def is_rawlog_of_ranges(path: Path) -> bool:
    """Whether `path` is a rawlog of ranges to beacons, without scans."""
    if not path.is_file() or not is_rawlog(path):
        return False
    held = read_rawlog(path)
    return bool(held.ranges) and not held.scans


def read_rawlog_ranges(path: Path) -> RangeLog:
    """Odometry and ranges to beacons of the file at `path`; its robot is `robot1`, beacon 7 is `beacon7`.

    Raises ReaderError for one without odometry, and where an antenna is not always at one place of the robot.
    """
    held = read_rawlog(path)
    t, first = np.unique([row[0] for row in held.odometry], return_index=True)
    if len(t) < 2:
        raise ReaderError(path, f"expected odometry beside ranges, found {len(t)} poses")
    if not held.ranges:
        raise ReaderError(path, "expected ranges to beacons, found none")
    antennas = np.array([row.antenna for row in held.ranges])
    if np.ptp(antennas, axis=0).max() > 1e-3:
        raise ReaderError(path, "expected one antenna on the robot, found several places of it")
    beacons = sorted({row.beacon for row in held.ranges}, key=lambda name: (len(name), name))
    names = ("robot1", *beacons)
    found = (Finding("log-short", value=f"{path.name}: {held.lost}", action="they are used"),) if held.lost else ()
    return RangeLog(
        {"robot1": Track(t, np.array(held.odometry)[first, 1:], frame="odom")},
        names,
        np.zeros(len(held.ranges), np.int64),
        np.array([names.index(row.beacon) for row in held.ranges], np.int64),
        np.array([row.t for row in held.ranges]),
        np.array([row.z for row in held.ranges]),
        antennas={"robot1": antennas[0]},
        dropped=dict(held.dropped),
        source=str(path),
        log_hash=held.log_hash,
        unused=tuple(held.unused(ranges=True)),
        findings=found,
    )


class _EndsError(Exception):
    """The file ends within an object."""


class _Reading:
    """The bytes of a rawlog and how far they are read; what is found goes into `log`."""

    def __init__(self, log: Rawlog, data: bytes) -> None:
        self.log, self.data, self.at = log, data, 0
        self.pose, self.moved = np.zeros(3), False  # the sum of the increments so far, and whether there was any
        self.stamp = 0.0  # the latest, which is that of what is seen after it and has none

    def whole(self) -> None:
        """Every object to the end."""
        while (found := STANDING.search(self.data, self.at)) is not None:
            self.at = began = found.start()
            try:
                name, version = self._header()
                if name in _READ:
                    _READ[name](self, version)
                elif name not in {"CSensoryFrame", "CActionCollection"}:
                    self.log.others[name] += 1
            except _EndsError:
                if STANDING.search(self.data, began + 1) is not None:
                    raise ReaderError(self.log.path, f"damaged at byte {began}") from None
                self.log.lost = self.log.lost or f"it ends within a record, at byte {began}"
                break
        if not self.moved:
            self.log.scans = [replace(scan, odometry=None) for scan in self.log.scans]
        if not (self.log.scans or self.log.ranges):
            seen = self.log.others + self.log.dropped
            there = ", ".join(f"{name} ({n})" for name, n in sorted(seen.items())) or "no observation"
            raise ReaderError(self.log.path, f"expected 2D scans or ranges to beacons, found {there}")

    def scan(self, version: int) -> None:
        aperture, leftwards, greatest = self._take("<f?f")
        place, mirrored = self._sensor_pose(cov=version < 6)
        count = int(self._take("<I")[0])
        ranges = self._array("<f4", count)
        valid = self._array("u1", count) if version >= 1 else (ranges < greatest).astype(np.uint8)
        if version >= 2:
            self._take("<f")
        t = self._stamp() if version >= 3 else self.stamp
        light = None
        if version >= 4:
            self._take("<f")
        label = ""
        if version >= 5:
            label = self._text()
            self._take("<d")
        if version >= 7 and self._take("<?")[0]:
            light = self._array("<i4", count).astype(float)
        if place is None:
            self.log.dropped[NOT_LEVEL] += 1
            return
        sign = 1.0 if bool(leftwards) != mirrored else -1.0
        step = float(aperture) / max(1, count - 1)
        r = np.where(valid != 0, ranges, np.inf).astype(float)
        first = -sign * float(aperture) / 2
        self.log.scans.append(
            RawScan(t, r, light, first, sign * step, 0.0, float(greatest), place, label, odometry=self.pose.copy())
        )
        self._carried(t)

    def odometry(self, _: int) -> None:
        pose = self._pose2()
        self._text()
        x, y, theta = pose.tolist()
        self.log.odometry.append((self._stamp(), x, y, theta))

    def beacons(self, version: int) -> None:
        self._take("<fff")
        rows = []
        for _ in range(int(self._take("<I")[0])):
            antenna = self._numbers("CPoint3D", 3)
            z, beacon = self._take("<fI")
            rows.append((f"beacon{beacon}", float(z), antenna[:2]))
        if version >= 1:
            self._pose2()
        if version >= 2:
            self._text()
        t = self._stamp() if version >= 3 else self.stamp
        self.log.ranges += [BeaconRange(t, *row) for row in rows]
        self._carried(t)

    def movement(self, version: int) -> None:
        if version < 3:
            raise ReaderError(self.log.path, f"byte {self.at}: CActionRobotMovement2D of version {version} is not read")
        measured = self._take("<i")[0] == 0
        if not measured:
            name, _ = self._header()
            if name != "CPosePDFGaussian":
                raise ReaderError(self.log.path, f"byte {self.at}: expected odometry, found motions as {name}")
        self.pose, self.moved = se2.compose(self.pose, self._pose2()), True
        if not measured or version < 6:  # where stamps stand depends on what else is there, or there is none
            self.stamp = 0.0
            return
        self._take("<i6fi6f")
        has_speed = self._take("<?")[0]
        if version >= 7:
            self._take("<3d" if has_speed else "")
        else:
            self._take("<2f")
        if self._take("<?")[0] or version < 7:
            self._take("<2i")
        self._stamp(of_action=True)

    def _carried(self, t: float) -> None:
        """What increments sum to is the odometry at what is seen then."""
        if self.moved and (not self.log.odometry or self.log.odometry[-1][0] != t):
            x, y, theta = self.pose.tolist()
            self.log.odometry.append((t, x, y, theta))

    def _stamp(self, *, of_action: bool = False) -> float:
        """[s] since 1970; of what has none, that of what was seen or done before."""
        ticks = int(self._take("<Q")[0])
        if ticks or of_action:
            self.stamp = ticks * TICK - EPOCH if ticks else 0.0
        return self.stamp

    def _sensor_pose(self, *, cov: bool) -> tuple[Float[np.ndarray, "3"] | None, bool]:
        """Where a scanner stands on the robot, None where it is not level, and whether it is upside down."""
        name, version = self._header()
        if name != "CPose3D":
            raise ReaderError(self.log.path, f"byte {self.at}: expected CPose3D, found {name}")
        if version <= 1:
            M = self._matrix()
            R, x = M[:3, :3], M[:3, 3]
        elif version == 2:
            *place, w, i, j, k = self._take("<7d")
            x = np.array(place)
            R = np.array(
                [
                    [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 0.0],
                    [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 0.0],
                    [0.0, 0.0, 1 - 2 * (i * i + j * j)],
                ]
            )
        else:
            numbers = np.array(self._take("<12d"))
            x, R = numbers[:3], numbers[3:].reshape(3, 3)
        self._end()
        if cov:
            self._header()
            self._at_matrix()
            self._end()
        level = abs(R[2, 2]) >= LEVEL
        return np.array([x[0], x[1], np.arctan2(R[1, 0], R[0, 0])]) if level else None, bool(R[2, 2] < 0)

    def _matrix(self) -> Float[np.ndarray, "4 4"]:
        name, _ = self._header()
        M = self._at_matrix("<f8" if name == "CMatrixD" else "<f4")
        self._end()
        if M.shape != (4, 4):
            raise ReaderError(self.log.path, f"byte {self.at}: expected a pose of 4 x 4, found {M.shape}")
        return M

    def _at_matrix(self, kind: str = "<f4") -> Float[np.ndarray, "r c"]:
        rows, cols = self._take("<II")
        return self._array(kind, int(rows * cols)).astype(float).reshape(int(rows), int(cols))

    def _pose2(self) -> Float[np.ndarray, "3"]:
        return self._numbers("CPose2D", 3)

    def _numbers(self, wanted: str, count: int) -> Float[np.ndarray, " n"]:
        """The coordinates of a pose or a point, of which version 0 is of 32 bits."""
        name, version = self._header()
        if name != wanted:
            raise ReaderError(self.log.path, f"byte {self.at}: expected {wanted}, found {name}")
        out = self._array("<f8" if version else "<f4", count).astype(float)
        self._end()
        return out

    def _header(self) -> tuple[str, int]:
        """Class, without its name space, and version."""
        size = int(self._take("<B")[0])
        old = size < 0x80
        if old:
            self._take("<3x")
        size &= 0x7F
        name = self.data[self.at : self.at + size]
        if self.at + size > len(self.data):
            raise _EndsError
        if not NAME.fullmatch(name):
            raise ReaderError(
                self.log.path, f"byte {self.at}: expected the name of a class, found {name[:12].hex(' ')}"
            )
        self.at += size
        version = int(self._take("<i" if old else "<B")[0])
        self.old = old
        short = name.decode().rpartition("::")[2]
        if not 0 <= version <= LATEST.get(short, 255):
            raise ReaderError(
                self.log.path,
                f"byte {self.at}: expected {short} of version {LATEST.get(short, 255)} at most, found {version}",
            )
        return short, version

    def _end(self) -> None:
        """The flag after an object, which the oldest files have not."""
        if not self.old and self._take("<B")[0] != END:
            raise ReaderError(self.log.path, f"byte {self.at}: expected the end of an object, found something else")

    def _text(self) -> str:
        size = int(self._take("<I")[0])
        return self._array("u1", size).tobytes().decode(errors="replace")

    def _take(self, kind: str) -> tuple[float, ...]:
        size = struct.calcsize(kind)
        if self.at + size > len(self.data):
            raise _EndsError
        self.at += size
        return struct.unpack_from(kind, self.data, self.at - size)

    def _array(self, kind: str, count: int) -> np.ndarray:
        size = int(count) * np.dtype(kind).itemsize
        if self.at + size > len(self.data):
            raise _EndsError
        self.at += size
        return np.frombuffer(self.data, kind, int(count), self.at - size)


_READ: Mapping[str, Callable[[_Reading, int], None]] = {
    "CObservation2DRangeScan": _Reading.scan,
    "CObservationOdometry": _Reading.odometry,
    "CObservationBeaconRanges": _Reading.beacons,
    "CActionRobotMovement2D": _Reading.movement,
}
