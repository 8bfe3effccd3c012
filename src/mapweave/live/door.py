"""The one door that every message of the team comes in by: what is read here can hurt nobody who works on it.

A message is refused, with one of a few words that refusals are counted by, when it is too large, of another version or
not of the protocol's form ("malformed"), or holds what no robot and no map process says ("implausible"). What a message
has to be beside earlier ones of its robot is checked where these are known (`LandmarkRecord`, `LaserRecord`), by
`expect_span` and `expect_steps` from here. Bounds are those of the readers of logs, or beyond: they keep
indices within 64 bits, tables within memory and loops within time, and judge nothing that a map could judge.
"""

import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from jaxtyping import Float

from ..core.findings import finding_of, unused_of
from ..io.assemble import CLOSEST, LARGEST, LATEST, WIDEST
from .messages import LARGEST as LARGEST_MESSAGE
from .messages import (
    LONGEST_NAME,
    MOST_LEVELS,
    PROTOCOL,
    Closed,
    Correction,
    GoalMessage,
    Header,
    MapState,
    Message,
    Numbers,
    Radios,
    RefusedError,
    Rows,
    ScanBeams,
    Scans,
    Snapshot,
    Status,
    Tile,
    is_name,
    square,
    stretch,
    unpack,
    unpack_triangle,
)
from .tiles import SIDE, is_tile

MOST_MESSAGES = 1 << 40  # in a history: sixty thousand years of twice a second
MOST_COUNTED = 1 << 53  # of anything: whole numbers up to there are told exactly in every language
MOST_NAMES = 100_000  # landmarks of a robot
MOST_ROBOTS = 1_000  # that a map process may tell of
LONGEST_TEXT = 4_096  # letters of a text for people, or of a landmark's name
MOST_TEXTS = 10_000  # of one message
MOST_BEAMS = 20_000  # of one scan: four times those of the finest scanner made
MOST_BEAMS_AT_ONCE = 250_000  # of one message: robots split theirs at 200,000, and more costs too long to read
GREATEST = 4e38  # of any other number that a sensor gives, in single precision; maps leave out what is absurd
MOST_VARIANCE = 1e16  # [m^2, rad^2]
LONGEST = 30 * 86400.0  # [s] from the first stamp of a history to its last
FASTEST = 100.0  # [m/s] of odometry, beside
JUMP = 100.0  # [m] that odometry may jump between two rows, as when it is set back
PSD_SLACK = 1e-6  # of its greatest variance that the least eigenvalue of a covariance may lie below 0, of rounding


class _Version(msgspec.Struct):
    v: int


class Envelope(msgspec.Struct):
    """What a numbered message is filed by."""

    robot: str
    run: str
    seq: int = 0


_envelope = msgspec.msgpack.Decoder(Envelope)
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)
_version = msgspec.msgpack.Decoder(_Version)


def decode(payload: bytes) -> Message:
    """The message; raises RefusedError for one that is too large, of another version, malformed or implausible."""
    if len(payload) > LARGEST_MESSAGE:
        raise RefusedError("oversized", f"{len(payload)} bytes, at most {LARGEST_MESSAGE}")
    try:
        version = _version.decode(payload).v
        if version != PROTOCOL:
            raise RefusedError("version", f"protocol {version}, this is {PROTOCOL}")
        message = _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RefusedError("malformed", str(error)) from None
    _check(message)
    return message


def kept(payload: bytes) -> Message:
    """The message of a payload that the store holds: what came of `decode` when it came was in its place."""
    return _decoder.decode(payload)


def envelope_of(payload: bytes) -> Envelope | None:
    """Whose message it is and which one, be the rest of it what it may; None where it does not even tell that."""
    try:
        return None if len(payload) > LARGEST_MESSAGE else _envelope.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def expect_span(first: float, stamps: Sequence[float] | Float[np.ndarray, " n"]) -> float:
    """The first stamp [s] of a history: `first`, or that of `stamps` when it is NaN; refused when it is too long."""
    if not len(stamps):
        return first
    first = float(stamps[0]) if math.isnan(first) else first
    last = float(stamps[-1])
    if last - first > LONGEST:
        raise RefusedError("implausible", f"a stamp {last - first:.3g} s after the first one, at most {LONGEST:g}")
    return first


def expect_steps(t: Float[np.ndarray, " n"], xy: Float[np.ndarray, "n 2"], what: str) -> None:
    """Refused unless every step between rows, ascending in `t` [s], is one that wheels or a set-back can tell."""
    step = np.hypot(*np.diff(xy, axis=0).T)
    far = step > JUMP + FASTEST * np.diff(t)
    if far.any():
        k = int(np.argmax(far))
        raise RefusedError("implausible", f"{what} that steps {step[k]:.3g} m in {t[k + 1] - t[k]:.3g} s")


def _check(message: Message) -> None:
    """Raises RefusedError unless all lists have the length they say and all numbers are within their bounds."""
    match message:
        case Header():
            _header(message)
        case Rows() | Scans() | Radios() | Closed():
            _numbered(message)
        case Status():
            _status(message)
        case Snapshot():
            _snapshot(message)
        case Correction():
            _names(message.robot, message.map)
            _pose(message.pose, message.cov)
            _expect(math.isfinite(message.scale) and message.scale > 0, "a scale above 0")
            _within(GREATEST, "a scale", message.scale)
        case GoalMessage():
            _names(message.map, message.of, message.robot)
            _pose(message.pose or (0.0,) * 3, ())
            _expect(0 <= message.component <= MOST_ROBOTS, "a part")
            _within(MOST_COUNTED, "a count", message.number)
        case Tile():
            _tile(message)
        case MapState():
            _states(message)


def _header(message: Header) -> None:
    _expect(0 <= message.seq <= MOST_MESSAGES, f"a number from 0 to {MOST_MESSAGES}")
    _expect(message.sensor in {"landmarks", "laser", "ranges"}, f"sensor {message.sensor[:LONGEST_NAME]!r}")
    _names(message.robot, message.log_robot)
    _texts(message.run, message.source, message.odometry_from, message.log_hash)
    _landmarks(message.names)
    _landmarks(message.bearing_names)
    _landmarks(message.others)
    _counts(message.dropped)
    _findings(message.findings)
    _unused(message.unused)
    _within(LARGEST, "a sweep", message.sweep)
    _expect(len(message.antenna) in {0, 2}, "two numbers of an antenna")
    _within(LARGEST, "an antenna", *message.antenna)
    if message.fixes is not None:
        _expect(len(message.fixes.antenna) == 2, "two numbers of an antenna")
        _within(LARGEST, "an antenna", *message.fixes.antenna)
        _texts(message.fixes.frame, message.fixes.topic)
        _counts(message.fixes.dropped)
    if len(message.misread):
        _within(LATEST, "a stamp", *unpack(message.misread, 1)[0].tolist())


def _findings(rows: Sequence[object]) -> None:
    """What a robot's log was found to be wrong with: of the codes there are, in texts that are not too long."""
    _expect(len(rows) <= MOST_TEXTS, f"{len(rows)} findings, at most {MOST_TEXTS}", "oversized")
    for row in rows:
        try:
            _texts(finding_of(row).text)
        except (ValueError, OverflowError) as error:
            raise RefusedError("malformed", str(error)[:LONGEST_TEXT]) from None


def _unused(rows: Sequence[object]) -> None:
    """What a recording held beside, each row of the form that `metrics.json` has it in."""
    _expect(len(rows) <= MOST_TEXTS, f"{len(rows)} rows of what was not used, at most {MOST_TEXTS}", "oversized")
    for row in rows:
        try:
            left = unused_of(row)
        except ValueError as error:
            raise RefusedError("malformed", str(error)[:LONGEST_TEXT]) from None
        _texts(left.source, left.topic, left.type, left.reason)
        _within(MOST_COUNTED, "a count", left.messages)


def _numbered(message: Rows | Scans | Radios | Closed) -> None:
    _names(message.robot)
    _texts(message.run)
    _expect(0 < message.seq <= MOST_MESSAGES, f"a number from 1 to {MOST_MESSAGES}")
    if not isinstance(message, Closed):
        fixes = unpack(message.fixes, 7)
        _column(LATEST, "a stamp", fixes[0])
        _column(LARGEST, "a place", fixes[1:4])
        _column(MOST_VARIANCE, "a variance", fixes[4:])
    if isinstance(message, Rows):
        _rows(message)
    elif isinstance(message, Scans):
        _scans(message)
    elif isinstance(message, Radios):
        _radios(message)


def _radios(message: Radios) -> None:
    track, told = unpack(message.track, 4), unpack(message.told, 2)
    _expect(told.shape[1] == len(message.whom), "an index a range")
    _expect(len(message.by) in {0, len(message.whom)}, "who measured each range, or none")
    _expect(all(0 <= k <= MOST_NAMES for k in (*message.whom, *message.by)), f"an index from 0 to {MOST_NAMES}")
    _column(LATEST, "a stamp", track[0], told[0])
    _column(LARGEST, "odometry", track[1:])
    _column(GREATEST, "a range", told[1])


def _rows(message: Rows) -> None:
    drive, seen, bearings = unpack(message.drive, 3), unpack(message.seen, 3), unpack(message.bearings, 2)
    for table, what in ((seen, message.what), (bearings, message.bearing_what)):
        _expect(table.shape[1] == len(what), "an index a sighting")
        _expect(all(0 <= k <= MOST_NAMES for k in what), f"an index from 0 to {MOST_NAMES}")
    _landmarks(message.names)
    _landmarks(message.bearing_names)
    _column(LATEST, "a stamp", drive[0], seen[0], bearings[0])
    _column(GREATEST, "a number", drive[1:], seen[1:], bearings[1:])


def _scans(message: Scans) -> None:
    track = unpack(message.track, 4)
    _column(LATEST, "a stamp", track[0])
    _column(LARGEST, "odometry", track[1:])
    _expect(sum(max(beams.n, 0) for beams in message.scans) <= MOST_BEAMS_AT_ONCE, "250,000 beams at most", "oversized")
    for scan in message.scans:
        _beams(scan)


def _beams(beams: ScanBeams) -> None:
    _expect(0 <= beams.n <= MOST_BEAMS, f"{beams.n} beams, at most {MOST_BEAMS}", "oversized")
    _expect(len(beams.hit) == (beams.n + 7) // 8, f"{beams.n} beams, {8 * len(beams.hit)} marks of returns")
    _within(LATEST, "a stamp", beams.t)
    _within(LARGEST, "an angle", beams.angle_min, beams.angle_increment)
    step = abs(beams.angle_increment)
    turns = step >= CLOSEST and step * (beams.n - 1) <= WIDEST
    _expect(beams.n < 2 or turns, f"{beams.n} beams, one every {step:.3g} rad", "implausible")
    _expect(beams.range_max > 0, "a largest range above 0")
    _pose(beams.mount, ())
    _pose(beams.odometry or beams.mount, ())
    _within(LARGEST, "a heading", beams.heading or 0.0)
    _texts(beams.host)
    _column(GREATEST, "a range", stretch(beams.ranges, beams.n))
    if beams.light is not None:
        _column(GREATEST, "light", stretch(beams.light, beams.n))


def _status(message: Status) -> None:
    _names(message.robot)
    _texts(message.run, message.sensor)
    _expect(0 <= message.last <= MOST_MESSAGES, f"a last number from 0 to {MOST_MESSAGES}")
    _expect(0 <= message.landmarks <= MOST_COUNTED, "counts from 0 on")
    _pose(message.pose, message.cov)
    _within(LATEST, "a stamp", message.clock, message.t)


def _snapshot(message: Snapshot) -> None:
    n = len(message.ids)
    _names(message.robot)
    _texts(message.run)
    _landmarks(message.ids)
    _expect(0 <= message.last <= MOST_MESSAGES, f"a last number from 0 to {MOST_MESSAGES}")
    _expect(len(message.counts) == n, "a count a landmark")
    _expect(all(0 <= k <= MOST_COUNTED for k in message.counts), "counts from 0 on")
    mean = unpack(message.mean, 2)
    _expect(mean.shape[1] == n, "two columns of means")
    _column(LARGEST, "a mean", mean)
    _covariance(unpack_triangle(message.cov, 3 + 2 * n))
    _pose(message.pose, ())
    _within(LATEST, "a stamp", message.t)


def _tile(message: Tile) -> None:
    _names(message.map)
    _within(LARGEST, "a cell", message.cell)
    _expect(message.cell > 0, "a cell's side above 0")
    _expect(0 < message.component <= MOST_ROBOTS and 0 <= message.level < MOST_LEVELS, "a part and a level")
    _within(2**31, "a square", message.i, message.j)
    _expect(not message.cells or is_tile(message.cells), f"a square of {SIDE} cells each way")


def _states(state: MapState) -> None:
    _names(state.map)
    _within(LATEST, "a stamp", state.clock)
    _within(MOST_COUNTED, "a count", state.fused)
    _expect(len(state.robots) <= MOST_ROBOTS, f"{len(state.robots)} robots", "oversized")
    _texts(*state.decisions, *state.unused.values())
    _names(*state.unused)
    _counts(state.refused)
    for robot in state.robots:
        _names(robot.robot)
        _texts(robot.run, robot.log_robot, robot.sensor, robot.doing)
        _expect(0 <= robot.have <= MOST_MESSAGES and -1 <= robot.last <= MOST_MESSAGES, "numbers of messages")
        _expect(0 <= robot.component <= MOST_ROBOTS, "a part")
        _within(GREATEST, "a rate", robot.rate)
        _within(LATEST, "an offset", robot.offset or 0.0, robot.offset_error or 0.0)
        _within(MOST_COUNTED, "a count", robot.landmarks, robot.doubled)
        _counts(robot.refused)
        for pose, cov in ((robot.pose or (0.0,) * 3, robot.cov), (robot.frame or (0.0,) * 3, ())):
            _pose(pose, cov)
    for landmark in state.landmarks:
        _texts(landmark.id)
        _within(LARGEST, "a place", landmark.x, landmark.y)
        _expect(len(landmark.cov) == 3, "three numbers of a covariance")
        _within(MOST_VARIANCE, "a variance", *landmark.cov)
        _expect(0 <= landmark.component <= MOST_ROBOTS, "a part")


def _names(*names: str) -> None:
    for name in names:
        _expect(is_name(name), f"name {name[:LONGEST_NAME]!r}")


def _texts(*texts: str, most: int = MOST_TEXTS) -> None:
    _expect(len(texts) <= most, f"{len(texts)} texts", "oversized")
    _expect(all(len(text) <= LONGEST_TEXT for text in texts), f"a text of over {LONGEST_TEXT} letters", "oversized")


def _landmarks(names: Sequence[str]) -> None:
    _texts(*names, most=MOST_NAMES)
    _expect(len(set(names)) == len(names), "a name comes twice")


def _counts(counts: Mapping[str, int]) -> None:
    _texts(*counts)
    _expect(all(0 <= n <= MOST_COUNTED for n in counts.values()), "counts from 0 on")


def _pose(pose: Numbers, cov: Numbers) -> None:
    _expect(len(pose) == 3 and len(cov) in {0, 6}, "a pose has 3 numbers, its covariance 6")
    _within(LARGEST, "a pose", *pose)
    if cov:
        _within(MOST_VARIANCE, "a variance", *cov)
        _covariance(square(cov))


def _covariance(P: Float[np.ndarray, "m m"]) -> None:
    """Symmetric by its form; refused unless its numbers are bounded and none of its variances is below 0."""
    _column(MOST_VARIANCE, "a variance", P)
    most = float(np.abs(P).max(initial=0.0))
    if most == 0.0:
        return
    try:
        np.linalg.cholesky(P / most + PSD_SLACK * np.eye(len(P)))
    except np.linalg.LinAlgError:
        raise RefusedError("implausible", "a covariance that is not positive definite") from None


def _within(most: float, what: str, *numbers: float) -> None:
    for x in numbers:
        _expect(math.isfinite(x), "a number that is not finite")
        _expect(abs(x) <= most, f"{what} of {x:.3g}, at most {most:g}", "implausible")


def _column(most: float, what: str, *columns: np.ndarray) -> None:
    """As `_within`, of arrays that are known to be finite."""
    for column in columns:
        x = float(np.abs(column).max(initial=0.0))
        _expect(x <= most, f"{what} of {x:.3g}, at most {most:g}", "implausible")


def _expect(true: bool, detail: str, reason: str = "malformed") -> None:  # noqa: FBT001
    if not true:
        raise RefusedError(reason, detail)
