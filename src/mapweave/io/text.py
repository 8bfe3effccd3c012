"""Lines of a plain or gzipped text log, as far as they can be read."""

import gzip
import hashlib
import zlib
from collections.abc import Iterator
from pathlib import Path

from ..core.errors import ReaderError

_GZIP = b"\x1f\x8b"
LARGEST_SMALL, LARGEST_RATIO = 1 << 26, 200  # [bytes] unpacked; bytes unpacked for one packed


class TextLog:
    """A text log held in memory; `truncated` says what was lost when a gzip stream ends too soon, else it is empty."""

    def __init__(self, path: Path) -> None:
        """Raises ReaderError when the file cannot be opened or is no text."""
        self.path, self.truncated = path, ""
        try:
            raw = path.read_bytes()
        except OSError as error:
            raise ReaderError(path, f"cannot be read: {error.strerror}") from None
        self.log_hash = hashlib.sha256(raw).hexdigest()
        data = self._unpacked(raw) if raw[:2] == _GZIP else raw
        if b"\0" in data[:4096]:
            raise ReaderError(path, "expected a text log, found binary data")
        self.text = data.decode("utf-8", errors="replace")
        self.complete = self.text.endswith("\n")

    def _unpacked(self, raw: bytes) -> bytes:
        engine, out, size = zlib.decompressobj(wbits=31), bytearray(), len(raw)
        most = max(LARGEST_SMALL, LARGEST_RATIO * size)
        try:
            while raw:
                out += engine.decompress(raw, most - len(out) + 1)
                if len(out) > most:
                    raise ReaderError(self.path, f"{size} bytes unpack to over {most}: no log is packed so well")
                if not engine.eof:
                    self.truncated = f"the gzip stream ends too soon, after {len(out)} bytes of text"
                    break
                raw = engine.unused_data
                if raw[:2] != _GZIP:
                    break
                engine = zlib.decompressobj(wbits=31)
        except zlib.error:
            # One damaged byte spoils the rest of a block: read on in small steps to keep what stands before it.
            out = bytearray(_as_far_as_possible(self.path, most))
            self.truncated = f"the gzip stream is damaged after {len(out)} bytes of text"
        return bytes(out)

    def lines(self) -> Iterator[tuple[int, str]]:
        """Line numbers from 1 and lines without their ends."""
        yield from enumerate(self.text.splitlines(), start=1)

    def head(self, n: int = 60) -> list[list[str]]:
        """The words of the first `n` lines that are not blank and no comments."""
        words = (line.split() for line in self.text[:400_000].splitlines())
        return [w for w in words if w and not w[0].startswith("#")][:n]


def _as_far_as_possible(path: Path, most: int) -> bytes:
    out = bytearray()
    try:
        with gzip.open(path) as stream:
            while len(out) < most and (piece := stream.read(256)):
                out += piece
    except (OSError, EOFError, zlib.error):
        pass
    return bytes(out)
