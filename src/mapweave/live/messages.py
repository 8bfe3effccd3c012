"""What processes of a team say to each other: MessagePack maps with a tag `type` and the protocol version `v`.

Numbered messages (`Header`, `Rows`, `Scans`, `Closed`) are a robot's history: number 0 is its header, and none is ever
changed. The others tell how things stand and may be lost. Columns are little-endian float64 (`columns`), times in
seconds of the robot's own clock, lengths in metres, angles in radians.
"""

import math
import re
from collections.abc import Mapping

import msgspec

from ..core.errors import DataError, MapweaveError, UsageError
from .tiles import SIDE, is_tile

PROTOCOL = 2
LARGEST = 1 << 20  # bytes of a message: beyond, it is refused unread
LONGEST_NAME = 64
MOST_LEVELS = 16  # of tiles
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")

Numbers = tuple[float, ...]


class _Message(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    v: int = PROTOCOL


class Header(_Message, tag="header", frozen=True):
    """The first message of a history: who tells it, and what its log is called by those who read it whole.

    sensor: "landmarks" or "laser"; log_robot: `robotK`; names: landmarks and robots by the index that `Rows.what`
    counts from; odometry: whether there is any; odometry_from, log_hash: of a laser's log; misread: stamps of
    sightings that were left out, a column.
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
    dropped: dict[str, int] = {}
    warnings: list[str] = []
    misread: bytes = b""


class Rows(_Message, tag="rows", frozen=True):
    """Rows of a landmark log that are later than those of all earlier messages.

    drive: columns t, v, w; seen: columns t, range, bearing; what: an index a sighting; names: put after those known.
    """

    robot: str
    run: str
    seq: int
    drive: bytes = b""
    seen: bytes = b""
    what: list[int] = []
    names: list[str] = []


class ScanBeams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One scan of n beams. ranges, light: numbers as `squeezed.squeeze` packs them; hit: a bit a beam, the first
    the highest of its byte; mount: `T_robot_sensor`; odometry: `T_odom_robot` at `t`.
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


class Scans(_Message, tag="scans", frozen=True):
    """Scans and odometry of a laser, later than those of all earlier messages. track: columns t, x, y, theta."""

    robot: str
    run: str
    seq: int
    scans: list[ScanBeams] = []
    track: bytes = b""


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


class RobotState(msgspec.Struct, frozen=True, kw_only=True):
    """What a map process knows of a robot. pose: `T_map_robot` or nothing; component: 1 is the largest.

    frame: `T_map_local`, where the robot's own frame stands, or nothing. have: messages held without a gap; last:
    newest it is known to have told; offset: its clock minus the map's [s], within `offset_error`.
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


class LandmarkState(msgspec.Struct, frozen=True, kw_only=True):
    """A landmark of the shared map. cov: xx, xy, yy [m^2]."""

    id: str
    x: float
    y: float
    cov: Numbers
    component: int


class MapState(_Message, tag="map", frozen=True):
    """The shared map as it stands. clock: the map process's wall clock [s]; refused: messages of no known robot."""

    map: str
    clock: float
    fused: int
    robots: list[RobotState]
    landmarks: list[LandmarkState]
    decisions: list[str]
    refused: dict[str, int] = {}


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


Numbered = Header | Rows | Scans | Closed
Message = Header | Rows | Scans | Closed | Status | Snapshot | Correction | MapState | Tile


class RefusedError(DataError):
    """A message that is not used. `reason` is one of a few words that refusals are counted by."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason


class _Version(msgspec.Struct):
    v: int


_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)
_version = msgspec.msgpack.Decoder(_Version)


def encode(message: Message) -> bytes:
    return _encoder.encode(message)


def decode(payload: bytes) -> Message:
    """The message; raises RefusedError for one that is too large, malformed, of another version or not finite."""
    if len(payload) > LARGEST:
        raise RefusedError("oversized", f"{len(payload)} bytes, at most {LARGEST}")
    try:
        version = _version.decode(payload).v
        if version != PROTOCOL:
            raise RefusedError("version", f"protocol {version}, this is {PROTOCOL}")
        message = _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RefusedError("malformed", str(error)) from None
    _check(message)
    return message


def check_name(name: str, what: str = "--name", wrong: type[MapweaveError] = UsageError) -> str:
    """`name`, when it may be part of a key; raises `wrong`: another error than UsageError where it is no option."""
    if len(name) > LONGEST_NAME or not NAME.fullmatch(name):
        raise wrong(f"{what}: expected letters, digits, '_', '-' or '.' (at most {LONGEST_NAME}), found {name!r}")
    return name


def _check(message: Message) -> None:
    """Raises RefusedError unless every number is finite and every list has the length it says."""
    match message:
        case Header():
            _expect(message.seq == 0, "a header is number 0")
            _expect(message.sensor in {"landmarks", "laser"}, f"sensor {message.sensor!r}")
            _names(message.robot, message.log_robot)
            _expect(len(set(message.names)) == len(message.names), "a name comes twice")
        case Rows():
            _names(message.robot)
            _expect(message.seq > 0, "rows have a number above 0")
            _expect(len(message.drive) % 24 == 0 and len(message.seen) % 24 == 0, "three columns of equal length")
            _expect(len(message.seen) // 24 == len(message.what), "an index a sighting")
            _expect(all(k >= 0 for k in message.what), "an index below 0")
        case Scans():
            _names(message.robot)
            _expect(message.seq > 0, "scans have a number above 0")
            _expect(len(message.track) % 32 == 0, "four columns of equal length")
            _beams(message.scans)
        case Closed():
            _names(message.robot)
            _expect(message.seq > 0, "the last message has a number above 0")
        case Status():
            _names(message.robot)
            _expect(message.last >= 0 and message.landmarks >= 0, "counts below 0")
            _pose(message.pose, message.cov)
            _finite(message.clock, message.t)
        case Snapshot():
            n = len(message.ids)
            size = 3 + 2 * n
            _names(message.robot)
            _expect(len(set(message.ids)) == n and len(message.counts) == n, "a count a landmark, a name once")
            _expect(len(message.mean) == 16 * n, "two columns of means")
            _expect(len(message.cov) == 4 * size * (size + 1), "the triangle of the covariance")
            _expect(all(k >= 0 for k in message.counts), "counts below 0")
            _pose(message.pose, ())
            _finite(message.t)
        case Correction():
            _names(message.robot, message.map)
            _pose(message.pose, message.cov)
            _expect(math.isfinite(message.scale) and message.scale > 0, "a scale above 0")
        case Tile():
            _names(message.map)
            _finite(message.cell)
            _expect(message.cell > 0, "a cell's side above 0")
            _expect(message.component > 0 and 0 <= message.level < MOST_LEVELS, "a part and a level")
            _expect(not message.cells or is_tile(message.cells), f"a square of {SIDE} cells each way")
        case MapState():
            _names(message.map)
            _states(message)


def _beams(scans: list[ScanBeams]) -> None:
    for beams in scans:
        _finite(beams.t, beams.angle_min, beams.angle_increment)
        _expect(beams.range_max > 0, "a largest range above 0")
        _pose(beams.mount, ())
        _pose(beams.odometry or beams.mount, ())


def _states(state: MapState) -> None:
    _finite(state.clock)
    for robot in state.robots:
        _names(robot.robot)
        _finite(robot.rate, *robot.pose, *robot.cov)
    for landmark in state.landmarks:
        _finite(landmark.x, landmark.y, *landmark.cov)


def _names(*names: str) -> None:
    for name in names:
        _expect(len(name) <= LONGEST_NAME and NAME.fullmatch(name) is not None, f"name {name[:LONGEST_NAME]!r}")


def _pose(pose: Numbers, cov: Numbers) -> None:
    _expect(len(pose) == 3 and len(cov) in {0, 6}, "a pose has 3 numbers, its covariance 6")
    _finite(*pose, *cov)


def _finite(*numbers: float) -> None:
    _expect(all(math.isfinite(x) for x in numbers), "a number that is not finite")


def _expect(true: bool, detail: str) -> None:  # noqa: FBT001
    if not true:
        raise RefusedError("malformed", detail)


def count(counts: Mapping[str, int]) -> str:
    """`2 malformed, 1 version`."""
    return ", ".join(f"{n} {reason}" for reason, n in sorted(counts.items()))
