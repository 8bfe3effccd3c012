"""Files as they come: a folder or a zip file as one thing, a text log plain or packed, one clear error for damage.

What is packed (gzip, bzip2, xz, zstd, zip of one file) is told by its first bytes and unpacked in memory; what stands
before damage, or before the end of a file cut short, is kept.
"""

import bz2
import hashlib
import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import ReaderError
from ..core.laser_log import LaserLog

try:
    from compression import zstd
except ImportError:  # before Python 3.14
    from backports import zstd

Engine = Callable[[], Any]

LARGEST_SMALL, LARGEST_RATIO = 1 << 26, 200  # [bytes] unpacked; bytes unpacked for one packed
LARGEST_WINDOW = 1 << 28  # [bytes] of memory an xz stream may ask for; `xz -9` asks for a quarter
COARSE, FINE = 1 << 16, 64  # [bytes] read at a time; what a damaged file has left is read in small steps
MOST_NAMES = 8  # of files in a zip file that a message lists
HIDDEN = ("__MACOSX", ".")
# What a damaged zip file makes the library say: NotImplementedError is a flipped compression method, and so on.
DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError, KeyError),
    *(NotImplementedError, RuntimeError, OverflowError, struct.error, zstd.ZstdError),
)


GZIP, ZIP = b"\x1f\x8b", b"PK\x03\x04"
EMPTY_ZIP = b"PK\x05\x06"
STREAMS: dict[bytes, tuple[str, Engine]] = {
    GZIP: ("gzip", lambda: zlib.decompressobj(wbits=31)),
    b"BZh": ("bzip2", bz2.BZ2Decompressor),
    b"\xfd7zXZ\0": ("xz", lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=LARGEST_WINDOW)),
    b"\x28\xb5\x2f\xfd": ("zstd", zstd.ZstdDecompressor),
}
IN_ZIP: dict[int, Engine] = {
    8: lambda: zlib.decompressobj(wbits=-15),
    12: bz2.BZ2Decompressor,
    93: zstd.ZstdDecompressor,
}


class Unpacked(NamedTuple):
    """lost: what is missing at the end, in words; empty when all is there."""

    data: bytes | bytearray
    lost: str


def unpacked(path: Path, raw: bytes) -> Unpacked:
    """The content of `raw`, the bytes of the file at `path`; `raw` itself when it is not compressed.

    Raises ReaderError for a zip file of several files or none, for what unpacks to more than any log does, and where
    nothing can be unpacked.
    """
    if raw.startswith((ZIP, EMPTY_ZIP)):
        return _of_zip(path, raw)
    for magic, (name, engine) in STREAMS.items():
        if raw.startswith(magic):
            return _told(path, f"the {name} stream", *_unpacked(path, raw, engine, magic))
    return Unpacked(raw, "")


def first_name(raw: bytes) -> str | None:
    """The name of the first file in a zip file of which `raw` is the beginning; None where it is none."""
    if not raw.startswith((ZIP, EMPTY_ZIP)):
        return None
    size = int.from_bytes(raw[26:28], "little") if raw.startswith(ZIP) else 0
    return raw[30 : 30 + size].decode(errors="replace")


def _told(path: Path, what: str, data: bytearray, end: str) -> Unpacked:
    if end and not data:
        raise ReaderError(path, f"{what} {end.format(size=0)}: nothing of it can be read")
    return Unpacked(data, f"{what} {end.format(size=len(data))}" if end else "")


def _unpacked(path: Path, raw: bytes, engine: Engine, magic: bytes | None) -> tuple[bytearray, str]:
    """What can be unpacked, and how it ends too soon. magic: how a further stream begins, where there may be some."""
    most = max(LARGEST_SMALL, LARGEST_RATIO * len(raw))
    out, end = _read(raw, engine, magic, most, COARSE)
    if end == "is damaged":
        out.clear()  # room for the second try
        out, end = _read(raw, engine, magic, most, FINE)
    if len(out) > most:
        raise ReaderError(path, f"{len(raw)} bytes unpack to over {most}: no log is packed so well")
    return out, f"{end} after {{size}} bytes of text" if end else ""


def _read(raw: bytes, engine: Engine, magic: bytes | None, most: int, step: int) -> tuple[bytearray, str]:
    """Up to a byte more than `most`, and how the reading ended."""
    out, at, stream = bytearray(), 0, engine()
    try:
        while at < len(raw):
            piece = raw[at : at + step]
            out += stream.decompress(piece, most - len(out) + 1)
            at += len(piece)
            if len(out) > most:
                return out, ""
            if stream.eof:
                at -= len(stream.unused_data)
                while magic is not None and raw[at : at + 1] == b"\0":  # streams may be padded
                    at += 1
                if magic is None or not raw.startswith(magic, at):
                    return out, ""
                stream = engine()
    except (*DAMAGE, OSError):
        return out, "is damaged"
    return out, "ends too soon,"


def _of_zip(path: Path, raw: bytes) -> Unpacked:
    """The only file of a zip file; of one without its list of contents, the first file as far as it goes."""
    at = 0
    try:
        with zipfile.ZipFile(BytesIO(raw)) as archive:
            entry = _only(path, archive)
            at = entry.header_offset
            if entry.file_size > max(LARGEST_SMALL, LARGEST_RATIO * entry.compress_size):
                packed = f"{entry.compress_size} bytes unpack to {entry.file_size}"
                raise ReaderError(path, f"{packed}: no log is packed so well")
            return Unpacked(archive.read(entry), "")
    except (*DAMAGE, OSError) as error:
        if "password" in str(error):
            raise ReaderError(path, "the zip file is encrypted: expected one that is not") from None
    what = "the zip file"
    if not raw.startswith(ZIP, at) or len(raw) < at + 30:
        raise ReaderError(path, f"{what} is damaged: nothing of it can be read")
    method, name, extra = (int.from_bytes(raw[at + k : at + k + 2], "little") for k in (8, 26, 28))
    body = raw[at + 30 + name + extra :]
    if method == 0:
        return _told(path, what, bytearray(body), "is cut short or damaged after {size} bytes of text")
    if method not in IN_ZIP:
        raise ReaderError(path, f"{what} is damaged: nothing of it can be read")
    data, _ = _unpacked(path, body, IN_ZIP[method], None)
    return _told(path, what, data, "is cut short or damaged after {size} bytes of text")


def _only(path: Path, archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    entries = {entry.filename: entry for entry in archive.infolist() if not entry.is_dir()}
    names = [name for name in entries if not any(part.startswith(HIDDEN) for part in name.split("/"))]
    if len(names) == 1:
        return entries[names[0]]
    listing = ", ".join([*names[:MOST_NAMES], *(["..."] if len(names) > MOST_NAMES else [])])
    raise ReaderError(path, f"expected one log in the zip file, found {len(names)} files{': ' * bool(names)}{listing}")


LONGEST = 1 << 20  # characters of a row whose every word counts; g2o's FIX of 100,000 vertices has fewer
LOOKED_AT = 1 << 22  # characters at the beginning of a log that tell its format
RECORDINGS = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}


def recording_suffix(path: Path) -> str:
    """`.bag`, `.mcap` or `.db3`, whichever recording the file at `path` begins as; empty for any other."""
    try:
        with path.open("rb") as file:
            start = file.read(max(map(len, RECORDINGS)))
    except OSError:
        return ""
    return recording_of(start)


def zip_begins_with(path: Path) -> str | None:
    """The name of the first file in the zip file at `path`; None for what is no zip file, whatever it is called."""
    try:
        with path.open("rb") as file:
            return first_name(file.read(1 << 12))
    except OSError:
        return None


def recording_of(start: bytes) -> str:
    """As `recording_suffix`, of the first bytes of a file."""
    return next((suffix for magic, suffix in RECORDINGS.items() if start.startswith(magic)), "")


def is_number(word: str) -> bool:
    """Whether a word of a text is a number, which `nan` and `inf` are too."""
    try:
        float(word)
    except ValueError:
        return False
    return True


class NotTextError(ReaderError):
    """What should be a text log is binary data."""


class TextLog:
    """A text log held in memory; `truncated` says what was lost where a packed one ends too soon, else it is empty."""

    def __init__(self, path: Path) -> None:
        """Raises ReaderError when the file cannot be opened or unpacked, or is no text."""
        self.path = path
        try:
            raw = path.read_bytes()
        except OSError as error:
            raise ReaderError(path, f"cannot be read: {error.strerror}") from None
        self.log_hash = hashlib.sha256(raw).hexdigest()
        try:
            data, self.truncated = unpacked(path, raw)
            if b"\0" in data[:4096]:
                raise NotTextError(path, "expected a text log, found binary data")
            self.text = data.decode("utf-8-sig", errors="replace")
        except MemoryError:
            raise ReaderError(path, f"{len(raw)} bytes hold more text than there is memory for") from None
        self.complete = self.text.endswith("\n")

    def lines(self) -> Iterator[tuple[int, str]]:
        """Line numbers from 1 and lines without their ends; raises ReaderError for one too long to cut into words."""
        for number, line in enumerate(self.text.splitlines(), start=1):
            if len(line) > LONGEST:
                problem = f"expected lines of at most {LONGEST} characters, found one of {len(line)}"
                raise ReaderError(self.path, problem, number)
            yield number, line

    def rows(self) -> list[tuple[int, list[str]]]:
        """Line numbers and words of the lines that are not blank."""
        return [(number, words) for number, line in self.lines() if (words := line.split())]

    def head(self, n: int = 60, passed: Collection[str] = ()) -> list[list[str]]:
        """The words of the first `n` lines that are not blank, no comments, and begin with none of `passed`."""
        words = (line.split() for line in self.text[:LOOKED_AT].splitlines())
        return list(islice((w for w in words if w and w[0] not in passed and not w[0].startswith("#")), n))


@dataclass(frozen=True, slots=True)
class TextFormat:
    """A format of laser logs that are text, as `mapweave.readers` registers it. reads: whether a text is of it."""

    reads: Callable[[TextLog], bool]
    read: Callable[..., LaserLog]


@dataclass(frozen=True, slots=True)
class Files:
    """The files of one data set. names: relative, with forward slashes; `where` is how messages call the whole."""

    where: Path
    names: tuple[str, ...]
    archive: zipfile.ZipFile | None = None

    def read(self, name: str) -> bytes:
        """The bytes of `name`; raises ReaderError when they cannot be had whole."""
        try:
            if self.archive is None:
                return (self.where / name).read_bytes()
            entry = self.archive.getinfo(name)
            if entry.file_size > max(LARGEST_SMALL, LARGEST_RATIO * entry.compress_size):
                problem = f"{entry.compress_size} bytes unpack to {entry.file_size}: no log is packed so well"
                raise ReaderError(self.label(name), problem)
            return self.archive.read(name)
        except OSError as error:
            raise ReaderError(self.label(name), f"cannot be read: {error.strerror or error}") from None
        except DAMAGE as error:
            raise ReaderError(self.label(name), f"the zip file is damaged here: {error}") from None

    def label(self, name: str) -> str:
        return f"{self.where}/{name}"

    def folder_of(self, names: list[str]) -> str:
        """The one folder ('' or 'name/') that holds all `names`; raises ReaderError when they lie in several."""
        folders = sorted({name.rpartition("/")[0] for name in names})
        if len(folders) > 1:
            listing = ", ".join(f or "(top)" for f in folders)
            raise ReaderError(self.where, f"expected one data set, found files of {len(folders)} mixed: {listing}")
        return f"{folders[0]}/" if folders and folders[0] else ""


@contextmanager
def open_files(path: Path) -> Iterator[Files]:
    """`path`, a folder (and the folders in it) or a zip file; raises ReaderError when it is neither or damaged."""
    if path.is_dir():
        names = [p.relative_to(path).as_posix() for p in sorted((*path.glob("*"), *path.glob("*/*"))) if p.is_file()]
        yield Files(path, _visible(names))
        return
    if not path.exists():
        raise ReaderError(path, "no such file or folder")
    try:
        archive = zipfile.ZipFile(path)
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except DAMAGE:
        raise ReaderError(
            path, "expected a folder or a zip file, found neither (or the zip file is cut short)"
        ) from None
    with archive:
        yield Files(path, _visible([n for n in sorted(archive.namelist()) if not n.endswith("/")]), archive)


def _visible(names: list[str]) -> tuple[str, ...]:
    return tuple(n for n in names if not any(part.startswith(HIDDEN) for part in n.split("/")))
