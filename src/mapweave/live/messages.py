"""What processes of a team say to each other: MessagePack maps with a tag `type` and the protocol version `v`.

Numbered messages (`Header`, `Rows`, `Scans`, `Closed`) are a robot's history: number 0 is its header, and none is ever
changed. The others tell how things stand and may be lost. Columns are little-endian float64 (`columns`), times in
seconds of the robot's own clock, lengths in metres, angles in radians. They are read by `door.decode` alone.

They are said under the keys of a team (`Topics`): a robot speaks under `mapweave/<team>/<robot>/` alone, a map process
under `mapweave/<team>/@map/<name>/`; no wildcard for robots takes in a chunk that begins with `@`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from ..core.errors import DataError, MapweaveError, UsageError

PROTOCOL = 4
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
    counts from, bearing_names: those that `Rows.bearing_what` does; odometry: whether there is any; odometry_from,
    log_hash, sweep ([s] that a scan takes, as its driver states it): of a laser's log; misread: stamps of sightings
    that were left out, a column.
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


class Rows(_Message, tag="rows", frozen=True):
    """Rows of a landmark log that are later than those of all earlier messages.

    drive: columns t, v, w; seen: columns t, range, bearing; what: an index a sighting; names: put after those known;
    bearings, bearing_what, bearing_names: the same of sightings that told no range, columns t, bearing.
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


Numbered = Header | Rows | Scans | Closed
Message = Header | Rows | Scans | Closed | Status | Snapshot | Correction | GoalMessage | MapState | Tile


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
    return len(name) <= LONGEST_NAME and NAME.fullmatch(name) is not None


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
