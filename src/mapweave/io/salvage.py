"""What can still be read of a recording that was cut short: its messages one by one, until they end."""

import bz2
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from lz4.block import LZ4BlockError
from lz4.frame import LZ4FrameDecompressor

try:
    from compression import zstd
except ImportError:  # before Python 3.14
    from backports import zstd

RawMessage = tuple[str, int, bytes]  # topic, recording time [ns], serialised message
MCAP_MAGIC = b"\x89MCAP0\r\n"
BAG_MAGIC = b"#ROSBAG V2.0\n"


@dataclass(slots=True)
class Salvage:
    """kinds: type of every topic; definitions: text of every type; messages: in the order of the file; read: bytes."""

    kinds: dict[str, str] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    messages: list[RawMessage] = field(default_factory=list)
    read: int = 0


def salvage(path: Path) -> Salvage:
    """All whole messages of `path` (.mcap, .bag or .db3) before the damage; none where even the head is gone."""
    if path.suffix == ".db3":
        return _sqlite(path)
    data = path.read_bytes()
    out = Salvage()
    if path.suffix == ".mcap" and data.startswith(MCAP_MAGIC):
        _mcap(data, len(MCAP_MAGIC), out, {}, {})
    elif path.suffix == ".bag" and data.startswith(BAG_MAGIC):
        _bag(data, len(BAG_MAGIC), out, {})
    return out


def _mcap(data: bytes, at: int, out: Salvage, schemas: dict[int, str], topics: dict[int, str]) -> None:
    while at + 9 <= len(data):
        code, size = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        body = data[at + 9 : at + 9 + size]
        whole = len(body) == size
        if code == 0x06:
            head = 28 + 4 + struct.unpack_from("<I", body, 28)[0] + 8 if len(body) >= 32 else len(body)
            _mcap(_inflated(_text(body, 28), body[head:]), 0, out, schemas, topics)
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


def _bag(data: bytes, at: int, out: Salvage, topics: dict[int, str]) -> None:
    while at + 4 <= len(data):
        (head_size,) = struct.unpack_from("<I", data, at)
        head = _fields(data[at + 4 : at + 4 + head_size])
        start = at + 8 + head_size
        if start > len(data) or "op" not in head:
            break
        (size,) = struct.unpack_from("<I", data, start - 4)
        body = data[start : start + size]
        code = head["op"][0]
        if code == 5:
            _bag(_inflated(head.get("compression", b"none").decode(), body), 0, out, topics)
        if len(body) < size:
            break
        if code == 7:
            (number,) = struct.unpack("<I", head["conn"])
            about = _fields(body)
            topics[number] = head["topic"].decode()
            kind = _ros2_name(about["type"].decode())
            out.kinds[topics[number]] = kind
            out.definitions[kind] = about["message_definition"].decode(errors="replace")
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
        while not engine.eof and (piece := source.read(4096)):
            out += engine.decompress(piece)
    except (OSError, EOFError, RuntimeError, LZ4BlockError, zstd.ZstdError):
        pass
    return bytes(out)


def _sqlite(path: Path) -> Salvage:
    out = Salvage(read=path.stat().st_size)
    try:
        for topic, kind, ns, data in _rows(path):
            out.kinds[topic] = kind
            out.messages.append((topic, ns, data))
    except sqlite3.DatabaseError:
        pass
    return out


def _rows(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    base = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    try:
        base.execute("PRAGMA writable_schema=ON")  # lets a file be opened that is shorter than its head says
        topics = {number: (name, kind) for number, name, kind in base.execute("SELECT id, name, type FROM topics")}
        for number, ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
            yield *topics[number], ns, data
    finally:
        base.close()
