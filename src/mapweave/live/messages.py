"""What processes of a team say to each other: MessagePack maps with a tag `type` and the protocol version `v`.

Numbered messages (`Header`, `Rows`, `Scans`, `Radios`, `Closed`) are a robot's history: number 0 is its header, and
none is ever changed. What a robot knows at the end alone is a header once more. The others tell how things stand
and may be lost. Columns are bytes: little-endian float64, one column after the other (`pack`), or as few as a sensor's
need (`squeeze`), which come back to the bit. Times are in seconds of the robot's own clock, lengths in metres, angles
in radians. They are read by `door.decode` alone.

They are said under the keys of a team (`Topics`): a robot speaks under `mapweave/<team>/<robot>/` alone, a map process
under `mapweave/<team>/@map/<name>/`; no wildcard for robots takes in a chunk that begins with `@`.
"""

import re
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float, Int

from ..core.errors import DataError, MapweaveError, UsageError
from ..core.records import frozen

PROTOCOL = 6
LARGEST = 1 << 20  # bytes of a message: beyond, it is refused unread
LONGEST_NAME = 64
MOST_LEVELS = 16  # of tiles
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")

Numbers = tuple[float, ...]


class _Message(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    v: int = PROTOCOL


class FixSource(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of what a robot's position fixes are; see `core.fixes.Fixes`."""

    frame: str
    topic: str
    antenna: Numbers
    dropped: dict[str, int]


class Header(_Message, tag="header", frozen=True):
    """The first message of a history: who tells it, and what its log is called by those who read it whole.

    A later one tells that anew, of scans or ranges, before the log is closed: those that follow it are the whole log
    once more, in place of what was told before.

    sensor: "landmarks", "laser" or "ranges"; log_robot: `robotK`, of ranges any name; names: landmarks and robots by
    the index that `Rows.what` counts from (`Radios.whom`: itself, robots and beacons), bearing_names: those that
    `Rows.bearing_what` does; antenna: [m, m] where a radio's stands on the robot, others: names that are robots too, of
    ranges; odometry: whether there is any; odometry_from, log_hash, sweep ([s] that a scan takes, as its driver states
    it): of a laser's log; misread: stamps of sightings that were left out, a column; fixes: of what its fixes are.
    """

    robot: str
    run: str
    sensor: str
    log_robot: str
    source: str
    odometry: bool
    seq: int = 0
    odometry_from: str = ""
    log_hash: str = ""
    names: list[str] = []
    bearing_names: list[str] = []
    dropped: dict[str, int] = {}
    findings: list[dict[str, Any]] = []
    unused: list[dict[str, Any]] = []
    misread: bytes = b""
    sweep: float = 0.0
    antenna: Numbers = ()
    others: list[str] = []
    fixes: FixSource | None = None


class Rows(_Message, tag="rows", frozen=True):
    """Rows of a landmark log that are later than those of all earlier messages.

    drive: columns t, v, w; seen: columns t, range, bearing; what: an index a sighting; names: put after those known;
    bearings, bearing_what, bearing_names: the same of sightings that told no range, columns t, bearing; fixes: columns
    t, three of the place, variances xx, xy, yy [m^2] of east and north, xx below 0 where the log has none.
    """

    robot: str
    run: str
    seq: int
    drive: bytes = b""
    seen: bytes = b""
    what: list[int] = []
    names: list[str] = []
    bearings: bytes = b""
    bearing_what: list[int] = []
    bearing_names: list[str] = []
    fixes: bytes = b""


class ScanBeams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scan of n beams. ranges, light: numbers as `squeezed.squeeze` packs them; hit: a bit a beam, the first
    the highest of its byte; mount: `T_robot_sensor`; odometry: `T_odom_robot` at `t`; heading: [rad] by a gyroscope.
    """

    t: float
    n: int
    ranges: bytes
    hit: bytes
    light: bytes | None
    angle_min: float
    angle_increment: float
    range_max: float
    mount: Numbers
    host: str
    odometry: Numbers | None
    heading: float | None


class Scans(_Message, tag="scans", frozen=True):
    """Scans and odometry of a laser, later than those of all earlier messages. track: columns t, x, y, theta; fixes: as
    of `Rows`.
    """

    robot: str
    run: str
    seq: int
    scans: list[ScanBeams] = []
    track: bytes = b""
    fixes: bytes = b""


class Radios(_Message, tag="radios", frozen=True):
    """Odometry and ranges of a robot, later than those of all earlier messages.

    track: columns t, x, y, theta; told: columns t, range; whom: an index a range, whom to; by: an index a range, who
    measured it, none where all are the robot's own; fixes: as of `Rows`.
    """

    robot: str
    run: str
    seq: int
    track: bytes = b""
    told: bytes = b""
    whom: list[int] = []
    by: list[int] = []
    fixes: bytes = b""


class Closed(_Message, tag="closed", frozen=True):
    """The last message: the log ended here."""

    robot: str
    run: str
    seq: int


class Status(_Message, tag="status", frozen=True):
    """How a robot stands, twice a second. last: number of its newest message; clock: its own wall clock [s].

    t: stamp [s] of its estimate; pose: `T_local_robot`; cov: its upper triangle xx, xy, xt, yy, yt, tt.
    """

    robot: str
    run: str
    sensor: str
    last: int
    clock: float
    t: float
    pose: Numbers
    cov: Numbers
    landmarks: int = 0
    finished: bool = False


class Snapshot(_Message, tag="snapshot", frozen=True):
    """A robot's own map as its estimator has it after message `last`: pose and landmarks in `local_k`.

    mean: columns x, y; cov: the upper triangle of the joint covariance of pose and landmarks, row by row; counts:
    sightings a landmark.
    """

    robot: str
    run: str
    last: int
    t: float
    pose: Numbers
    ids: list[str]
    mean: bytes
    cov: bytes
    counts: list[int]


class Correction(_Message, tag="correction", frozen=True):
    """What a map process tells a robot: `T_map_local` of its frame, the covariance's upper triangle, the scale."""

    map: str
    robot: str
    pose: Numbers
    cov: Numbers
    scale: float


class GoalMessage(_Message, tag="goal", frozen=True):
    """Where a planner sends a robot: `T_map_robot` in a part of the map of map process `of`, or nothing: it may stand.

    map: who tells it; number: counts the robot's goals, so that one that is told again is known.
    """

    map: str
    of: str
    robot: str
    component: int
    number: int
    pose: Numbers = ()


class RobotState(msgspec.Struct, frozen=True, kw_only=True):
    """What a map process knows of a robot. pose: `T_map_robot` or nothing; component: 1 is the largest.

    frame: `T_map_local`, where the robot's own frame stands, or nothing. have: messages held without a gap; last:
    newest it is known to have told; offset: its clock minus the map's [s], within `offset_error`; doing: in a word.
    """

    robot: str
    run: str
    log_robot: str
    sensor: str
    there: bool
    finished: bool
    have: int
    last: int
    rate: float
    pose: Numbers = ()
    cov: Numbers = ()
    frame: Numbers = ()
    component: int = 0
    landmarks: int = 0
    offset: float | None = None
    offset_error: float | None = None
    refused: dict[str, int] = {}
    doubled: int = 0
    doing: str = ""


class LandmarkState(msgspec.Struct, frozen=True, kw_only=True):
    """A landmark of the shared map. cov: xx, xy, yy [m^2]."""

    id: str
    x: float
    y: float
    cov: Numbers
    component: int


class MapState(_Message, tag="map", frozen=True):
    """The shared map as it stands. clock: the map process's wall clock [s]; refused: messages of no known robot.

    unused: robots of whom nothing, or nothing more, is used, and why.
    """

    map: str
    clock: float
    fused: int
    robots: list[RobotState]
    landmarks: list[LandmarkState]
    decisions: list[str]
    refused: dict[str, int] = {}
    unused: dict[str, str] = {}


class Tile(_Message, tag="tile", frozen=True):
    """A square of the occupancy map of a part. Tile (i, j) has its lower left corner at `(i, j) * 128 * cell` [m].

    level: 0 the finest; cell: [m]; cells: a zlib stream of 128 rows of 128 bytes from below, 0 unseen, else 1 (free) to
    255 (occupied); empty where there is no such square any more.
    """

    map: str
    component: int
    level: int
    i: int
    j: int
    cell: float
    cells: bytes


Numbered = Header | Rows | Scans | Radios | Closed
Message = Header | Rows | Scans | Radios | Closed | Status | Snapshot | Correction | GoalMessage | MapState | Tile


class RefusedError(DataError):
    """A message that is not used. `reason` is one of a few words that refusals are counted by."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason


_encoder = msgspec.msgpack.Encoder()


def encode(message: Message) -> bytes:
    return _encoder.encode(message)


def is_name(name: str) -> bool:
    """Whether it may be part of a key."""
    return isinstance(name, str) and len(name) <= LONGEST_NAME and NAME.fullmatch(name) is not None


def check_name(name: str, what: str = "--name", wrong: type[MapweaveError] = UsageError) -> str:
    """`name`, when it may be part of a key; raises `wrong`: another error than UsageError where it is no option."""
    if not is_name(name):
        raise wrong(f"{what}: expected letters, digits, '_', '-' or '.' (at most {LONGEST_NAME}), found {name!r}")
    return name


def count(counts: Mapping[str, int]) -> str:
    """`2 malformed, 1 version`."""
    return ", ".join(f"{n} {reason}" for reason, n in sorted(counts.items()))


EVERY = "*"
LEVEL = "level"  # in a question for squares: of this one alone


@dataclass(frozen=True, slots=True)
class Topics:
    """The keys of `team`."""

    team: str

    def log(self, robot: str = EVERY) -> str:
        """Numbered messages, published once as they come."""
        return f"mapweave/{self.team}/{robot}/log"

    def history(self, robot: str = EVERY) -> str:
        """Answers `?first=A;last=B` with the numbered messages A to B, one reply each."""
        return f"mapweave/{self.team}/{robot}/history"

    def status(self, robot: str = EVERY) -> str:
        return f"mapweave/{self.team}/{robot}/status"

    def snapshot(self, robot: str = EVERY) -> str:
        return f"mapweave/{self.team}/{robot}/snapshot"

    def clock(self, robot: str = EVERY) -> str:
        """Answers with the robot's wall clock [s] in decimals."""
        return f"mapweave/{self.team}/{robot}/clock"

    def alive(self, robot: str = EVERY) -> str:
        """The liveliness token of a robot."""
        return f"mapweave/{self.team}/{robot}/alive"

    def map_state(self, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/state"

    def map_alive(self, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/alive"

    def correction(self, robot: str, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/correction/{robot}"

    def goal(self, robot: str, name: str = EVERY) -> str:
        """Where a robot is to drive, told again and again."""
        return f"mapweave/{self.team}/@map/{name}/goal/{robot}"

    def tile(self, name: str = EVERY, tile: Tile | None = None, level: int | None = None) -> str:
        """One square of the map, published when it has changed; of all of them, or all of a level."""
        where = "**" if level is None else f"*/{level}/*/*"
        if tile is not None:
            where = f"{tile.component}/{tile.level}/{tile.i}/{tile.j}"
        return f"mapweave/{self.team}/@map/{name}/tile/{where}"

    def tiles(self, name: str = EVERY) -> str:
        """Answers with all squares of the map, or `?level=L` with those of a level, one reply each."""
        return f"mapweave/{self.team}/@map/{name}/tiles"

    def robot_of(self, key: str) -> str:
        """Whose key it is."""
        return key.split("/")[2]

    def map_of(self, key: str) -> str:
        """Which map process's key it is."""
        return key.split("/")[3]


TRIANGLE = np.triu_indices(3)


def pack(*columns: Sequence[float] | np.ndarray) -> bytes:
    """Equal-length columns (n,), or the rows of one array."""
    return np.ascontiguousarray(columns, dtype="<f8").tobytes()


def unpack(data: bytes, columns: int) -> Float[np.ndarray, "c n"]:
    """The columns; raises RefusedError when they are not of equal length or a number is not finite."""
    if len(data) % (8 * columns):
        raise RefusedError("malformed", f"expected {columns} columns of equal length, found {len(data)} bytes")
    values = np.frombuffer(data, dtype="<f8").reshape(columns, -1)
    if not np.isfinite(values).all():
        raise RefusedError("malformed", "a number that is not finite")
    return frozen(values)


def pack_triangle(P: Float[np.ndarray, "m m"]) -> bytes:
    """The upper triangle of a symmetric matrix, row by row."""
    return pack(P[np.triu_indices(len(P))])


def unpack_triangle(data: bytes, size: int) -> Float[np.ndarray, "m m"]:
    """The symmetric matrix; raises RefusedError when its diagonal holds a negative number."""
    values = unpack(data, 1)[0]
    if len(values) != size * (size + 1) // 2:
        raise RefusedError("malformed", f"expected the triangle of {size} x {size} numbers, found {len(values)}")
    P = np.zeros((size, size))
    P[np.triu_indices(size)] = values
    P = P + np.triu(P, 1).T
    if (np.diag(P) < 0).any():
        raise RefusedError("malformed", "a variance below 0")
    return P


def listed(pose: Float[np.ndarray, "3"]) -> tuple[float, ...]:
    return tuple(float(x) for x in pose)


def triangle(P: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    """xx, xy, xt, yy, yt, tt."""
    return tuple(float(x) for x in P[TRIANGLE])


def square(numbers: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The symmetric matrix of which `triangle` gives the numbers; zero of none."""
    P = np.zeros((3, 3))
    P[TRIANGLE] = numbers or 0.0
    return P + np.triu(P, 1).T


THOUSAND = 1000.0  # millimetres in a metre, milliseconds in a second
LARGEST_WHOLE = 2**31 - 1


class Kind(NamedTuple):
    """How numbers become whole ones and come back."""

    whole: Callable[[Float[np.ndarray, " n"]], np.ndarray]
    numbers: Callable[[Int[np.ndarray, " n"]], Float[np.ndarray, " n"]]


def _single(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)


def _bits(values: np.ndarray) -> np.ndarray:
    """The bits of float32 as whole numbers in the order of what they mean."""
    bits = values.astype(np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, -(1 << 31) - bits - 1, bits)


def _of_bits(whole: np.ndarray) -> np.ndarray:
    bits = np.where(whole < 0, -(1 << 31) - whole - 1, whole).astype(np.int32)
    return bits.view(np.float32).astype(np.float64)


KINDS: Mapping[str, Kind] = {
    "i": Kind(np.rint, lambda k: k.astype(np.float64)),
    "m": Kind(lambda v: np.rint(v * THOUSAND), lambda k: k / THOUSAND),
    "s": Kind(lambda v: np.rint(v * THOUSAND), lambda k: _single(k / THOUSAND)),
    "f": Kind(_bits, _of_bits),
}
EXACT = "d"
KEPT_COLUMNS, KEPT_LONGEST = 1024, 1500  # columns of messages kept as they were read, and numbers in one: 12 MB at most


def squeeze(values: Float[np.ndarray, " n"]) -> bytes:
    """The numbers to the bit: a letter for how they are told, then a zlib stream of it.

    i: whole numbers; m: thousandths; s: thousandths that were rounded to float32; f: the bits of float32 as a whole
    number that grows with it. Each as int32, with a capital letter each but the first less the one before it, folded so
    that small ones of either sign have high bytes of 0; then all lowest bytes, all next ones, to the highest.
    d: float64, little-endian.
    """
    for letter, kind in KINDS.items():
        with np.errstate(over="ignore"):
            whole = kind.whole(values)
        if not (np.abs(whole) <= LARGEST_WHOLE).all():
            continue
        whole = whole.astype(np.int64)
        if kind.numbers(whole).tobytes() != values.tobytes():
            continue
        steps = np.diff(whole, prepend=0)
        encodings = [letter.encode() + zlib.compress(_planes(whole), 6)]
        if (np.abs(steps) <= LARGEST_WHOLE).all():
            encodings.append(letter.upper().encode() + zlib.compress(_planes(steps), 6))
        return min(encodings, key=len)
    return EXACT.encode() + zlib.compress(values.astype("<f8").tobytes(), 6)


def stretch(data: bytes, n: int) -> Float[np.ndarray, " n"]:
    """The n numbers of `squeeze`; raises RefusedError when they are not n or not finite.

    Who checks a message and who reads it next ask for the same numbers: of columns of ordinary length they are kept.
    """
    return _kept_stretched(data, n) if n <= KEPT_LONGEST else _stretched(data, n)


@lru_cache(KEPT_COLUMNS)
def _kept_stretched(data: bytes, n: int) -> Float[np.ndarray, " n"]:
    return _stretched(data, n)


def _stretched(data: bytes, n: int) -> Float[np.ndarray, " n"]:
    letter = data[:1].decode("ascii", errors="replace")
    if letter != EXACT and letter.lower() not in KINDS:
        raise RefusedError("malformed", "a column of no known kind")
    raw = _inflated(data[1:], n * (8 if letter == EXACT else 4))
    if letter == EXACT:
        values = np.frombuffer(raw, "<f8").astype(np.float64)
    else:
        folded = np.frombuffer(raw, np.uint8).reshape(4, n).T
        whole = np.ascontiguousarray(folded).view("<u4")[:, 0].astype(np.int64) if n else np.zeros(0, np.int64)
        whole = np.where(whole & 1, -(whole >> 1) - 1, whole >> 1)
        whole = np.cumsum(whole) if letter.isupper() else whole
        if not (np.abs(whole) <= LARGEST_WHOLE).all():
            raise RefusedError("malformed", "a whole number of more than 32 bits")
        values = KINDS[letter.lower()].numbers(whole)
    if not np.isfinite(values).all():
        raise RefusedError("malformed", "a number that is not finite")
    return frozen(values)


def _planes(whole: Int[np.ndarray, " n"]) -> bytes:
    """Folded, and all lowest bytes first."""
    folded = np.where(whole < 0, -2 * whole - 1, 2 * whole).astype("<u4")
    return folded.view(np.uint8).reshape(-1, 4).T.tobytes()


def _inflated(stream: bytes, size: int) -> bytes:
    """What the zlib stream holds, of which no more than `size` bytes are unpacked; RefusedError when it is not that."""
    inflater = zlib.decompressobj()
    try:
        raw = inflater.decompress(stream, size + 1)
    except zlib.error as error:
        raise RefusedError("malformed", f"a column that cannot be unpacked: {error}") from None
    if len(raw) != size or inflater.unconsumed_tail or not inflater.eof:
        raise RefusedError("malformed", f"a column that does not hold {size} bytes")
    return raw


P_co = TypeVar("P_co", covariant=True)  # what one message says


class Record(Protocol[P_co]):
    """How far a robot's messages came: `add` gives what one of them says, None of one without rows."""

    header: Header
    closed: bool

    def add(self, message: Numbered) -> P_co | None: ...


def told_by(messages: Iterable[Message], begun: Callable[[Header], Record[P_co]]) -> tuple[Header, list[P_co]] | None:
    """The header and what the messages after it say, in their order; None without one.

    begun: the record of a history. Of a log that is told anew, what it was before until it is told to the end.
    """
    every = iter(messages)
    first = next(every, None)
    if not isinstance(first, Header):
        return None
    record = begun(first)
    parts: list[P_co] = []
    anew: list[P_co] = []
    now = parts
    for message in every:
        if isinstance(message, Numbered):
            part = record.add(message)
            if isinstance(message, Header):
                now = anew = []
            elif part is not None:
                now.append(part)
    return (record.header, anew or parts) if record.closed else (first, parts)
