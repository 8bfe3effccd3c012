"""Files as they come: a folder or a zip file as one thing, a text log plain or packed, one clear error for damage."""

import hashlib
import zipfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..core.errors import ReaderError
from ..core.laser_log import LaserLog
from .packed import DAMAGE, HIDDEN, LARGEST_RATIO, LARGEST_SMALL, first_name, unpacked

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
