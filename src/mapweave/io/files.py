"""A folder or a zip file as one thing: names in, bytes out, and one clear error when it is not whole."""

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import ReaderError
from .text import LARGEST_RATIO, LARGEST_SMALL

# What a damaged zip file makes the library say.
DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError, KeyError),
    *(NotImplementedError, RuntimeError, OverflowError, struct.error),
)
HIDDEN = ("__MACOSX", ".")


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
                told = f"{entry.compress_size} bytes unpack to {entry.file_size}: no log is packed so well"
                raise ReaderError(self.label(name), told)
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
            told = ", ".join(f or "(top)" for f in folders)
            raise ReaderError(self.where, f"expected one data set, found files of {len(folders)} mixed: {told}")
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
