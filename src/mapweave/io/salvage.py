"""What can still be read of a recording that was cut short: its messages one by one, until they end."""

import bz2
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import apsw
from lz4.block import LZ4BlockError
from lz4.frame import LZ4FrameDecompressor
from rosbags.highlevel import AnyReaderError
from rosbags.rosbag1 import ReaderError as Bag1Error
from rosbags.rosbag2 import ReaderError as Bag2Error
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from ..core.errors import ReaderError
from .files import recording_suffix

try:
    from compression import zstd
except ImportError:  # before Python 3.14
    from backports import zstd

RawMessage = tuple[str, int, bytes]  # topic, recording time [ns], serialised message
MCAP_MAGIC = b"\x89MCAP0\r\n"
BAG_MAGIC = b"#ROSBAG V2.0\n"
LARGEST_CHUNK, LARGEST_RATIO = 1 << 28, 200  # [bytes] unpacked; bytes unpacked for one packed that raise suspicion
# What a damaged recording makes its readers say; each of them only ever means "this cannot be read".
DAMAGE = (
    *(OSError, ValueError, LookupError, TypeError, AttributeError, AssertionError, ArithmeticError, EOFError),
    *(RuntimeError, MemoryError, struct.error, zlib.error, apsw.Error, sqlite3.Error, LZ4BlockError, zstd.ZstdError),
    *(AnyReaderError, Bag1Error, Bag2Error, SerdeError, TypesysError, SyntaxError),
)


@dataclass(slots=True)
class Salvage:
    """kinds: type of every topic; definitions: text of every type; messages: in the order of the file; read: bytes."""

    kinds: dict[str, str] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    messages: list[RawMessage] = field(default_factory=list)
    read: int = 0


def salvage(path: Path) -> Salvage:
    """All whole messages of `path` (.mcap, .bag or .db3) before the damage; none where even the head is gone."""
    suffix = recording_suffix(path)
    if suffix == ".db3":
        return _sqlite(path)
    data = path.read_bytes()
    out = Salvage()
    try:
        if suffix == ".mcap":
            _mcap(data, len(MCAP_MAGIC), out, {}, {})
        elif data.startswith(BAG_MAGIC):
            _bag(data, len(BAG_MAGIC), out, {})
    except DAMAGE:  # what was found before it stays
        pass
    return out


def check_chunks(path: Path) -> None:
    """Raises ReaderError for a recording with a part that unpacks to more than LARGEST_CHUNK."""
    whole = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(len(BAG_MAGIC))
        file.seek(len(MCAP_MAGIC) if start.startswith(MCAP_MAGIC) else len(BAG_MAGIC))
        chunks = _mcap_chunks if start.startswith(MCAP_MAGIC) else _bag_chunks if start == BAG_MAGIC else None
        for how, size in [] if chunks is None else chunks(file, whole):
            data = file.read(min(size, 4096))
            if len(_inflated(how, data)) > LARGEST_RATIO * len(data):
                data += file.read(max(0, size - len(data)))
                if len(_inflated(how, data)) > LARGEST_CHUNK:
                    raise ReaderError(
                        path, f"a part of {size} bytes unpacks to over {LARGEST_CHUNK}: no log is so packed"
                    )


def _mcap_chunks(file: IO[bytes], whole: int) -> Iterator[tuple[str, int]]:
    """How each chunk is packed and how many bytes it has, `file` standing at the first of them."""
    while len(head := file.read(9)) == 9:
        size = int.from_bytes(head[1:], "little")
        end = file.tell() + size
        if head[0] == 0x06:
            body = file.read(32)
            how = file.read(min(64, int.from_bytes(body[28:], "little")))
            file.read(8)
            yield how.decode(errors="replace"), max(0, end - file.tell())
        if end >= whole:  # of a file that grows meanwhile no more than there was
            return
        file.seek(end)


def _bag_chunks(file: IO[bytes], whole: int) -> Iterator[tuple[str, int]]:
    """As `_mcap_chunks`, of a ROS 1 bag."""
    while len(word := file.read(4)) == 4:
        head = _fields(file.read(min(1 << 20, int.from_bytes(word, "little"))))
        size = int.from_bytes(file.read(4), "little")
        end = file.tell() + size
        if head.get("op") == b"\x05":
            yield head.get("compression", b"none").decode(errors="replace"), size
        if end >= whole:  # of a file that grows meanwhile no more than there was
            return
        file.seek(end)


def _mcap(
    data: bytes, at: int, out: Salvage, schemas: dict[int, str], topics: dict[int, str], *, inside: bool = False
) -> None:
    while at + 9 <= len(data):
        code, size = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        body = data[at + 9 : at + 9 + size]
        whole = len(body) == size
        if code == 0x06 and not inside:
            head = 28 + 4 + struct.unpack_from("<I", body, 28)[0] + 8 if len(body) >= 32 else len(body)
            _mcap(_inflated(_text(body, 28), body[head:]), 0, out, schemas, topics, inside=True)
        if not whole or code in (0x02, 0x0F):
            break
        if code == 0x03:
            (number,) = struct.unpack_from("<H", body)
            name, encoding = _text(body, 2), _text(body, 6 + len(_text(body, 2)))
            schemas[number] = name
            out.definitions[name] = _text(body, 10 + len(name) + len(encoding))
        elif code == 0x04:
            number, schema = struct.unpack_from("<HH", body)
            topics[number] = _text(body, 4)
            out.kinds[topics[number]] = schemas.get(schema, "")
        elif code == 0x05 and size >= 22:
            number, _, ns = struct.unpack_from("<HIQ", body)
            if number in topics:
                out.messages.append((topics[number], ns, body[22:]))
        at += 9 + size
    out.read = max(out.read, at)


def _text(body: bytes, at: int) -> str:
    if at + 4 > len(body):
        return ""
    (size,) = struct.unpack_from("<I", body, at)
    return body[at + 4 : at + 4 + size].decode(errors="replace")


def _bag(data: bytes, at: int, out: Salvage, topics: dict[int, str], *, inside: bool = False) -> None:
    while at + 4 <= len(data):
        (head_size,) = struct.unpack_from("<I", data, at)
        head = _fields(data[at + 4 : at + 4 + head_size])
        start = at + 8 + head_size
        if start > len(data) or "op" not in head:
            break
        (size,) = struct.unpack_from("<I", data, start - 4)
        body = data[start : start + size]
        code = head["op"][0]
        if code == 5 and not inside:
            _bag(_inflated(head.get("compression", b"none").decode(), body), 0, out, topics, inside=True)
        if len(body) < size:
            break
        if code == 7:
            (number,) = struct.unpack("<I", head["conn"])
            about = _fields(body)
            topics[number] = head["topic"].decode()
            kind = _ros2_name(about["type"].decode())
            out.kinds[topics[number]] = kind
            out.definitions[kind] = with_header(about["message_definition"].decode(errors="replace"))
        elif code == 2:
            (number,) = struct.unpack("<I", head["conn"])
            sec, nsec = struct.unpack("<II", head["time"])
            if number in topics:
                out.messages.append((topics[number], sec * 10**9 + nsec, body))
        at = start + size
    out.read = max(out.read, at)


def _fields(data: bytes) -> dict[str, bytes]:
    out: dict[str, bytes] = {}
    at = 0
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
        out[name.decode(errors="replace")] = value
        at += 4 + size
    return out


def with_header(definition: str) -> str:
    """A ROS 1 type's text with the header under the name it has had since ROS Diamondback (2011)."""
    return definition.replace("roslib/Header", "std_msgs/Header")


def _ros2_name(kind: str) -> str:
    return kind if "/msg/" in kind else kind.replace("/", "/msg/")


def _inflated(how: str, data: bytes) -> bytes:
    """As much of `data` as can be unpacked."""
    engine: Any
    if how == "lz4":
        engine = LZ4FrameDecompressor()
    elif how == "zstd":
        engine = zstd.ZstdDecompressor()
    elif how == "bz2":
        engine = bz2.BZ2Decompressor()
    else:
        return data
    out, source = bytearray(), BytesIO(data)
    try:
        while not engine.eof and len(out) <= LARGEST_CHUNK and (piece := source.read(4096)):
            out += engine.decompress(piece)
    except DAMAGE:
        pass
    return bytes(out)


def _sqlite(path: Path) -> Salvage:
    out = Salvage(read=path.stat().st_size)
    try:
        for topic, kind, ns, data in _rows(path):
            out.kinds[topic] = kind
            out.messages.append((topic, ns, data))
    except DAMAGE:  # what was found before it stays
        pass
    return out


def _rows(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    base = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    try:
        base.execute("PRAGMA writable_schema=ON")  # lets a file be opened that is shorter than its head says
        topics = {number: (name, kind) for number, name, kind in base.execute("SELECT id, name, type FROM topics")}
        for number, ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
            name, kind = topics.get(number, (None, None))
            if isinstance(name, str) and isinstance(kind, str) and isinstance(ns, int) and isinstance(data, bytes):
                yield name, kind, ns, data
    finally:
        base.close()
