"""Numbered messages kept on disk: what a robot has told, and what a map process has heard. SQLite in WAL mode.

A message that was put is there after a kill at any moment; none is ever changed by another that comes. Of a file that
its disk has damaged all that is still as it was written is used, and the rest is there no more.
"""

import sqlite3
import uuid
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from threading import RLock
from types import TracebackType
from typing import Any

from ..core.errors import DataError, UsageError

VERSION = "2"
UNCHECKED = "1"  # the version before, without checksums
SCHEMA = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE messages (
    robot TEXT, seq INTEGER, payload BLOB NOT NULL, crc INTEGER, PRIMARY KEY (robot, seq)
) WITHOUT ROWID;
"""
DAMAGED = ".damaged"  # ends the name of a damaged file that was put aside
# all there is, from either end
ROWS = (
    "SELECT robot, seq, payload, crc FROM messages ORDER BY robot, seq",
    "SELECT robot, seq, payload, crc FROM messages ORDER BY robot DESC, seq DESC",
)
WORDS = "SELECT name, value FROM about ORDER BY name", "SELECT name, value FROM about ORDER BY name DESC"
Row = tuple[str, int, bytes, int | None]  # robot, number, payload, checksum of these


class Store:
    """The messages of one robot or many in the file `path`.

    owner: what the file is for ("robot r1 of team", "a map of team"): a file of another owner or version is refused.
    Only one process at a time holds a store; its threads may share it. damage: that the file was found damaged, and
    what came of it, in words; empty where it was not.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self.path, self.damage = path, ""
        self._lock = RLock()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._open(owner)
        with self._locked(), self._closed_on_error():
            try:
                self._check(owner)
                sound = all(map(_as_written, self._db.execute(ROWS[0])))
            except sqlite3.DatabaseError as error:
                if "locked" in str(error):
                    raise
                sound = False
            if not sound:
                self._rescue(owner)

    def _open(self, owner: str) -> None:
        """The file is held, and holds at least its tables."""
        try:
            self._db = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None, timeout=1.0)
        except sqlite3.Error as error:
            raise UsageError(f"{self.path}: {error}") from None
        with self._locked(), self._closed_on_error():
            self._db.execute("PRAGMA locking_mode=EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("BEGIN IMMEDIATE")
            if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
                _begin(self._db, owner)
            self._db.execute("COMMIT")
            tables = {name for (name,) in self._db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"about", "messages"} <= tables:
                raise UsageError(f"{self.path}: a database of something else")

    def _check(self, owner: str) -> None:
        known = dict(self._db.execute("SELECT name, value FROM about"))
        version, holder = known.get("version"), known.get("owner")
        if version not in {VERSION, UNCHECKED}:
            raise UsageError(f"{self.path}: a store of version {version}, this is {VERSION}")
        if holder != owner:
            raise UsageError(f"{self.path}: holds {holder}, expected {owner}")
        if version == UNCHECKED:
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute("ALTER TABLE messages ADD COLUMN crc INTEGER")
            self._db.execute("UPDATE about SET value = ? WHERE name = 'version'", (VERSION,))
            self._db.execute("COMMIT")

    def _rescue(self, owner: str) -> None:
        """What can be read from either end up to the damage is in a new file; the damaged one lies beside it."""
        aside, fresh = (self.path.with_name(self.path.name + end) for end in (DAMAGED, ".rescued"))
        fresh.unlink(missing_ok=True)
        with closing(sqlite3.connect(fresh, isolation_level=None)) as new:
            new.execute("BEGIN IMMEDIATE")
            _begin(new, owner)
            for question in WORDS:
                new.executemany("INSERT OR IGNORE INTO about VALUES (?, ?)", _readable(self._db, question))
            for question in ROWS:
                sound = filter(_as_written, _readable(self._db, question))
                new.executemany("INSERT OR IGNORE INTO messages VALUES (?, ?, ?, ?)", sound)
            saved = new.execute("SELECT COUNT(*) FROM messages").fetchone()[0]
            new.execute("COMMIT")
        self._db.close()
        for end in ("-wal", "-shm"):
            self.path.with_name(self.path.name + end).unlink(missing_ok=True)
        aside.unlink(missing_ok=True)
        try:
            aside.hardlink_to(self.path)  # so that one of both is there whenever this ends
        except OSError:
            self.path.replace(aside)
        fresh.replace(self.path)
        self._open(owner)
        self.damage = (
            f"{self.path} was damaged: {saved} messages could be read and are used; it was put aside as {aside}"
        )

    def about(self, name: str) -> str | None:
        """A word kept beside the messages."""
        with self._locked():
            row = self._db.execute("SELECT value FROM about WHERE name = ?", (name,)).fetchone()
        return None if row is None else str(row[0])

    def set_about(self, name: str, value: str) -> None:
        with self._locked():
            self._db.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (name, value))

    def put(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        """(robot, number, payload) each, all of them or none; one that is there already stays as it is."""
        with self._locked():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                self._db.executemany("INSERT OR IGNORE INTO messages VALUES (?, ?, ?, ?)", map(_checked, messages))
                self._db.execute("COMMIT")
            except sqlite3.Error:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def replace(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        """As `put`, but each in place of what is there."""
        with self._locked():
            self._db.executemany("INSERT OR REPLACE INTO messages VALUES (?, ?, ?, ?)", map(_checked, messages))

    def forget(self, robot: str) -> None:
        """No message of `robot` is there any more."""
        with self._locked():
            self._db.execute("DELETE FROM messages WHERE robot = ?", (robot,))

    def get(self, robot: str, first: int, last: int) -> list[tuple[int, bytes]]:
        """Numbers and payloads from `first` to `last`, in order; those not there are left out."""
        question = "SELECT seq, payload FROM messages WHERE robot = ? AND seq BETWEEN ? AND ? ORDER BY seq"
        with self._locked(), closing(self._db.execute(question, (robot, first, last))) as rows:
            return [(int(seq), bytes(payload)) for seq, payload in rows]

    def robots(self) -> list[str]:
        """All that messages are of."""
        with self._locked():
            return [str(robot) for (robot,) in self._db.execute("SELECT DISTINCT robot FROM messages")]

    def numbers(self, robot: str) -> list[int]:
        """All numbers of `robot`, ascending."""
        with self._locked():
            return [
                int(n) for (n,) in self._db.execute("SELECT seq FROM messages WHERE robot = ? ORDER BY seq", (robot,))
            ]

    def sizes(self, robot: str) -> tuple[int, ...]:
        """Bytes of every message of `robot`, in order."""
        question = "SELECT LENGTH(payload) FROM messages WHERE robot = ? ORDER BY seq"
        with self._locked():
            return tuple(int(n) for (n,) in self._db.execute(question, (robot,)))

    def clear(self) -> None:
        """All messages forgotten, and every word but version and owner."""
        with self._locked():
            self._db.execute("BEGIN IMMEDIATE")
            self._db.execute("DELETE FROM messages")
            self._db.execute("DELETE FROM about WHERE name NOT IN ('version', 'owner')")
            self._db.execute("COMMIT")

    def close(self) -> None:
        with self._locked():
            self._db.close()

    def __enter__(self) -> "Store":  # noqa: PYI034  (Self cannot be checked outside of its class)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def _locked(self) -> Iterator[None]:
        try:
            with self._lock:
                yield
        except sqlite3.DatabaseError as error:
            reason = str(error)
            if "locked" in reason:
                reason = "another process holds it"
            raise DataError(f"{self.path}: {reason}") from None

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._db.close()
            raise


def _begin(db: sqlite3.Connection, owner: str) -> None:
    """The tables of an empty store."""
    for statement in SCHEMA.split(";\n"):
        db.execute(statement)
    db.executemany("INSERT INTO about VALUES (?, ?)", [("version", VERSION), ("owner", owner)])


def _checked(message: tuple[str, int, bytes]) -> Row:
    robot, seq, payload = message
    return robot, seq, payload, zlib.crc32(payload, zlib.crc32(f"{robot} {seq}".encode()))


def _as_written(row: Row) -> bool:
    """Whether a message is the one that was put; one of a version without checksums is believed."""
    robot, seq, payload, crc = row
    return isinstance(payload, bytes) and (crc is None or _checked((robot, seq, payload))[3] == crc)


def _readable(db: sqlite3.Connection, question: str) -> Iterator[Any]:
    """The rows that come before the first that cannot be read."""
    with suppress(sqlite3.DatabaseError):
        yield from db.execute(question)


def begun(store: Store, sensor: str, period: float) -> str:
    """The run this history is of; raises UsageError when it was begun in another way."""
    run = store.about("run")
    if run is None:
        run = uuid.uuid4().hex
        store.set_about("sensor", sensor)
        store.set_about("period", repr(period))
        store.set_about("run", run)
    if store.about("sensor") != sensor:
        raise UsageError(f"{store.path}: the history of a robot with {store.about('sensor')}, this has {sensor}")
    if store.about("period") != repr(period):
        raise UsageError(f"--period: this history was begun with {store.about('period')} s, found {period}")
    return run
