"""ROS 1 and ROS 2 recordings as one thing: topics, and their messages in time order."""

import hashlib
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from ..core.errors import ReaderError
from .salvage import Salvage, salvage

Stamped = tuple[str, int, Any]  # topic, recording time [ns], message
SUFFIXES = (".bag", ".mcap", ".db3")
# What a damaged file makes a parser say; each of them only ever means "this cannot be read".
DAMAGE = (OSError, ValueError, KeyError, IndexError, TypeError, AssertionError, struct.error, apsw.Error, EOFError)


@dataclass(slots=True)
class Bag:
    """kinds: the type of every topic; counts: its messages; lost: what could not be read, empty when all could."""

    path: Path
    kinds: dict[str, str]
    counts: dict[str, int]
    lost: str
    _salvaged: Salvage | None = None

    def topics(self, *kinds: str) -> list[str]:
        """Topics of one of the `kinds`, the fullest first."""
        mine = [topic for topic, kind in self.kinds.items() if kind in kinds]
        return sorted(mine, key=lambda topic: (-self.counts.get(topic, 0), topic))

    def listing(self) -> str:
        return ", ".join(f"{t} ({self.kinds[t]}, {self.counts.get(t, 0)} messages)" for t in sorted(self.kinds))

    def messages(self, topics: Collection[str], once: Collection[str] = ()) -> Iterator[Stamped]:
        """The messages of `topics`, of those in `once` the first alone.

        The reading stops quietly at damage, and `lost` then says so.
        """
        done: set[str] = set()
        if self._salvaged is not None:
            for topic, ns, message in _unpacked(self, self._salvaged, topics):
                if topic not in done:
                    yield topic, ns, message
                done.update({topic} & set(once))
            return
        with AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [c for c in reader.connections if c.topic in topics]
            for connection, ns, data in reader.messages(connections=wanted) if wanted else ():
                if connection.topic not in done:
                    yield connection.topic, ns, reader.deserialize(data, connection.msgtype)
                if connection.topic in once:
                    done.add(connection.topic)


def open_bag(path: Path, kinds_read: Collection[str]) -> Bag:
    """The recording at `path` (a file, or a ROS 2 folder), of which topics of the types `kinds_read` will be read.

    Those are read through once, since a damaged middle shows only then. Raises ReaderError when nothing can be read.
    """
    path = _single(path)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            kinds = {c.topic: c.msgtype for c in reader.connections}
            counts: Counter[str] = Counter()
            for c in reader.connections:
                counts[c.topic] += c.msgcount
            wanted = [c for c in reader.connections if c.msgtype in kinds_read]
            for _ in reader.messages(connections=wanted) if wanted else ():
                pass
    except (AnyReaderError, TypesysError, *DAMAGE) as error:
        found = salvage(path) if path.is_file() else Salvage()
        if not found.messages:
            raise ReaderError(path, f"not a readable ROS recording: {_short(error)}") from None
        lost = f"cut short or damaged ({_short(error)}): {len(found.messages)} messages could be read"
        counts = Counter(topic for topic, _, _ in found.messages)
        return Bag(path, found.kinds, dict(counts), lost, found)
    return Bag(path, kinds, dict(counts), "")


def bag_hash(path: Path) -> str:
    """SHA-256 over the recording's files."""
    digest = hashlib.sha256()
    for part in [path] if path.is_file() else sorted(p for p in path.iterdir() if p.suffix in SUFFIXES):
        digest.update(part.read_bytes())
    return digest.hexdigest()


def _single(path: Path) -> Path:
    """A folder without metadata but with one recording stands for that recording."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        inside = sorted(p for p in path.iterdir() if p.suffix in SUFFIXES)
        if len(inside) == 1:
            return inside[0]
        raise ReaderError(path, f"expected metadata.yaml or one recording, found {len(inside)} recordings")
    return path


def _unpacked(bag: Bag, found: Salvage, topics: Collection[str]) -> Iterator[Stamped]:
    ros1 = bag.path.suffix == ".bag"
    store = get_typestore(Stores.EMPTY if ros1 else Stores.ROS2_HUMBLE)
    for kind, text in found.definitions.items():
        known = get_types_from_msg(text, kind)
        store.register({name: fields for name, fields in known.items() if name not in store.fielddefs})
    for topic, ns, data in found.messages:
        if topic in topics:
            kind = bag.kinds[topic]
            yield topic, ns, store.deserialize_ros1(data, kind) if ros1 else store.deserialize_cdr(data, kind)


def _short(error: BaseException) -> str:
    return str(error).split("\n", 1)[0].rstrip(".")[:120] or type(error).__name__
