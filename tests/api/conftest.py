"""What several files of this folder begin with: two robots in one office, and the map that is made of their logs."""

import pickle
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import pytest

import mapweave
from mapweave.io import kept
from mapweave.io.tum import write_tum

from ..laser.team_logs import cut, office, part_of

HOUR = 3600.0


class Remembered(kept._Keeper):
    """Parts of work in memory, for as long as the tests run."""

    held: ClassVar[dict[str, bytes]] = {}

    def earlier(self, name):
        return (pickle.loads(self.held[name]),) if name in self.held else None  # noqa: S301  (our own)

    def keep(self, name, value):
        if name:
            self.held[name] = pickle.dumps(value)

    def write_waiting(self):
        """Nothing waits."""


@contextmanager
def remembering():
    token = kept._keeper.set(Remembered(Path()))
    try:
        yield
    finally:
        kept._keeper.reset(token)


@pytest.fixture(scope="module")
def _remembered():
    """Within, a log that was mapped with the same settings is not mapped again: what is kept of it is used.

    For modules whose tests ask what becomes of the maps of single robots.
    """
    with remembering():
        yield


@pytest.fixture(scope="session")
def office_logs():
    """Two logs of one floor, the second by a clock an hour off, and what is true of each."""
    log, truth = office(3)
    n = len(log.scans)
    logs = [cut(log, 0, int(0.62 * n)), cut(log, int(0.38 * n), n, "2", HOUR)]
    return logs, [part_of(truth, part, clock) for part, clock in zip(logs, (0.0, HOUR), strict=True)]


@pytest.fixture(scope="session")
def logs(office_logs):
    return office_logs[0]


@pytest.fixture(scope="session")
def office_truth(office_logs, tmp_path_factory):
    """The files of what is true."""
    folder = tmp_path_factory.mktemp("truth")
    paths = [folder / f"robot{k}.tum" for k in (1, 2)]
    for path, true in zip(paths, office_logs[1], strict=True):
        write_tum(path, true)
    return paths


@pytest.fixture(scope="session")
def office_map(office_logs, tmp_path_factory):
    """Their map and its folder, which no test changes."""
    out = tmp_path_factory.mktemp("office") / "out"
    with remembering():
        return mapweave.map(office_logs[0], out), out
