"""What is said of a file of no known format: how it begins, and what the formats nearest to it would need."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..core.errors import ReaderError
from .directory import MARKERS
from .files import is_number, recording_of, unpacked

LOOKED_AT = 1 << 16  # [bytes] at the beginning
ROWS, SHOWN, WIDTH = 60, 2, 48  # rows looked at, rows shown, and characters of each
NEAREST = 3
BINARY_SHOWN = 12  # [bytes]


class FirstRows(NamedTuple):
    """The first rows of a text, cut into words. numbers: share of the words that are numbers; words: in a row."""

    seen: frozenset[str]
    numbers: float
    words: int


class Format(NamedTuple):
    """words: by which its rows are told, in lower case; shape: from 0 to 1, how much rows without them are alike."""

    name: str
    words: frozenset[str]
    shape: Callable[[FirstRows], float]
    needs: str


def _of(*words: str) -> frozenset[str]:
    return frozenset(words)


def _columns(low: int, high: int) -> Callable[[FirstRows], float]:
    """FirstRows of so many numbers."""
    return lambda rows: rows.numbers * (low <= rows.words <= high)


def _named(low: int) -> Callable[[FirstRows], float]:
    """FirstRows of a word and so many numbers or more."""
    return lambda rows: 0.5 * (0.5 < rows.numbers < 1.0 and rows.words > low)


FORMATS = (
    Format(
        "CARMEN",
        _of("flaser", "rlaser", "robotlaser1", "odom", "param", "rawlaser1", "laser", "carmen"),
        _named(12),
        "rows 'FLASER n r1 .. rn', laser pose, robot pose, stamp, or ROBOTLASER1, and ODOM",
    ),
    Format(
        "a log without stamps", _of("odometry", "laser"), _named(3), "rows 'Odometry x y theta' and 'Laser n r1 .. rn'"
    ),
    Format(
        "a log in centimetres",
        _of("o", "l"),
        _named(4),
        "rows 'O x y theta t' and 'L x y theta xl yl thetal r1 .. r180 t'",
    ),
    Format(
        "URG-04LX with wheel ticks",
        _of("urg"),
        _columns(60, 1 << 20),
        "rows of 125 numbers and more: microseconds, -, two wheel ticks, ranges [mm] from the 25th",
    ),
    Format(
        "a table of scans",
        _of("t", "x", "y", "theta", "ranges", "angle_min"),
        _columns(20, 1 << 20),
        "`--columns t,x,y,theta,ranges --beams FIRST,STEP`",
    ),
    Format(
        "CSV tables",
        _of("t", "time", "robot", "v", "w", "id", "range", "bearing"),
        _columns(4, 5),
        "a folder with sightings.csv (t,robot,id,range,bearing) and odometry.csv (t,robot,v,w)",
    ),
    Format(
        "MRCLAM",
        _of("barcode", "subject", "time"),
        _columns(3, 4),
        "a folder or zip file with Barcodes.dat, RobotN_Odometry.dat and RobotN_Measurement.dat",
    ),
    Format(
        "a pose graph",
        _of("vertex_se2", "edge_se2", "fix", "vertex2", "edge2"),
        lambda _: 0.0,
        "`mapweave solve`, for it holds no scans",
    ),
    Format("a trajectory", _of("qx", "qw"), _columns(8, 8), "`--truth`, for it holds no scans"),
    Format(
        "a swarm",
        _of("observer", "target", "bearing", "azimuth", "elevation", "bx", "by", "bz"),
        lambda _: 0.0,
        "`mapweave locate`, for it holds sightings between robots",
    ),
)
BINARY = (
    "a ROS recording begins with '#ROSBAG V2.0' (.bag), '\\x89MCAP0' (.mcap) or 'SQLite format 3' (.db3), "
    "a rawlog of MRPT with the name of a class"
)


def not_known(path: Path) -> ReaderError:
    """The error for `path`, which no reader takes: it is damaged or empty, or its format is none that is known."""
    if path.is_dir():
        return ReaderError(path, _folder(path))
    try:
        data, _ = unpacked(path, path.read_bytes())
    except OSError as error:
        return ReaderError(path, f"cannot be read: {error.strerror}")
    except MemoryError:
        return ReaderError(path, "holds more than there is memory for")
    except ReaderError as error:
        return error
    return ReaderError(path, _content(bytes(data[:LOOKED_AT])))


def _content(start: bytes) -> str:
    """What is wrong with a file that begins with `start`."""
    if not start.strip():
        return "expected a log, found an empty file"
    if recording_of(start):
        return "a ROS recording, compressed as a whole: unpack it first"
    if b"\0" in start[:4096]:
        begins = start[:BINARY_SHOWN].hex(" ")
        return f"expected a log of a known format, found binary data that begins {begins}; {BINARY}"
    lines = [line for line in start.decode("utf-8", errors="replace").splitlines() if line.strip()]
    begins = " / ".join(_shown(line) for line in lines[:SHOWN])
    nearest = "; ".join(f"{f.name} needs {f.needs}" for f in nearest_formats(lines))
    return f"expected a log of a known format, found text that begins {begins}. Nearest: {nearest}"


def nearest_formats(lines: Sequence[str]) -> list[Format]:
    """The three formats with most words in common with `lines`, and then of the shape most alike."""
    rows = _rows(lines)
    return sorted(FORMATS, key=lambda f: -(len(f.words & rows.seen) + f.shape(rows)))[:NEAREST]


def _rows(lines: Sequence[str]) -> FirstRows:
    cut = [line.replace(",", " ").replace(";", " ").lower().split() for line in lines[:ROWS]]
    words = [word for row in cut for word in row]
    counts = sorted(len(row) for row in cut)
    numbers = sum(is_number(word) for word in words) / max(1, len(words))
    return FirstRows(frozenset(words), numbers, counts[len(counts) // 2] if counts else 0)


def _shown(text: str) -> str:
    """The beginning of a line, in quotes, what cannot be printed as a dot."""
    printable = "".join(c if c.isprintable() else "." for c in text.expandtabs(1)[: WIDTH + 1])
    return f"'{printable[:WIDTH].rstrip()}{' ..' if len(text) > WIDTH else ''}'"


def _folder(path: Path) -> str:
    try:
        names = sorted(p.name for p in path.iterdir())
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if MARKERS[0] in names:
        return "it is a result: expected the logs it is of; `mapweave fuse` takes results"
    listing = ", ".join(_shown(name) for name in names[:5]) + (", .." if len(names) > 5 else "")
    tables = next(f for f in FORMATS if f.name == "CSV tables").needs
    mrclam = next(f for f in FORMATS if f.name == "MRCLAM").needs
    found = f"found {len(names)} entries: {listing}" if names else "found nothing in it"
    return f"expected {mrclam}; or {tables}; or a ROS 2 recording with metadata.yaml; {found}"
