"""Numbered messages kept on disk: what a robot has told, and what a map process has heard. SQLite in WAL mode.

A message that was put is there after a kill at any moment; none is ever changed by another that comes.
"""

import sqlite3
import uuid
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from threading import RLock
from types import TracebackType

from ..core.errors import DataError, UsageError

VERSION = "1"
SCHEMA = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE messages (robot TEXT, seq INTEGER, payload BLOB NOT NULL, PRIMARY KEY (robot, seq)) WITHOUT ROWID;
"""


class Store:
    """The messages of one robot or many in the file `path`.

    owner: what the file is for ("robot r1 of team", "a map of team"): a file of another owner or version is refused.
    Only one process at a time holds a store; its threads may share it.
    """

    def __init__(self, path: Path, owner: str) -> None:
        self.path = path
        self._lock = RLock()
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._db = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=1.0)
        except sqlite3.Error as error:
            raise UsageError(f"{path}: {error}") from None
        with self._locked(), self._closed_on_error():
            self._db.execute("PRAGMA locking_mode=EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("BEGIN IMMEDIATE")
            if not self._db.execute("SELECT 1 FROM sqlite_master").fetchone():
                for statement in SCHEMA.split(";\n"):
                    self._db.execute(statement)
                self._db.executemany("INSERT INTO about VALUES (?, ?)", [("version", VERSION), ("owner", owner)])
            self._db.execute("COMMIT")
            self._check(owner)

    def _check(self, owner: str) -> None:
        tables = {name for (name,) in self._db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if "about" not in tables:
            raise UsageError(f"{self.path}: a database of something else")
        version, holder = self.about("version"), self.about("owner")
        if version != VERSION:
            raise UsageError(f"{self.path}: a store of version {version}, this is {VERSION}")
        if holder != owner:
            raise UsageError(f"{self.path}: holds {holder}, expected {owner}")

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
                self._db.executemany("INSERT OR IGNORE INTO messages VALUES (?, ?, ?)", messages)
                self._db.execute("COMMIT")
            except sqlite3.Error:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def replace(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        """As `put`, but each in place of what is there."""
        with self._locked():
            self._db.executemany("INSERT OR REPLACE INTO messages VALUES (?, ?, ?)", messages)

    def forget(self, robot: str) -> None:
        """No message of `robot` is there any more."""
        with self._locked():
            self._db.execute("DELETE FROM messages WHERE robot = ?", (robot,))

    def get(self, robot: str, first: int, last: int) -> list[tuple[int, bytes]]:
        """Numbers and payloads from `first` to `last`, in order; those not there are left out."""
        question = "SELECT seq, payload FROM messages WHERE robot = ? AND seq BETWEEN ? AND ? ORDER BY seq"
        with self._locked(), closing(self._db.execute(question, (robot, first, last))) as rows:
            return [(int(seq), bytes(payload)) for seq, payload in rows]

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
