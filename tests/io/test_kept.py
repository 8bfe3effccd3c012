"""Long work that was stopped goes on: finished parts are used again, by the very same command and by no other."""

import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mapweave.core.errors import DataError
from mapweave.io import kept
from mapweave.io.kept import kept_parts, part, parts

from ..caches import own_cache


class BrokenError(Exception):
    pass


CALLS: list[float] = []
BREAK_AT: list[float] = []


def square(value: float) -> float:
    if value in BREAK_AT:
        raise BrokenError
    CALLS.append(value)
    return value * value


def size(path: Path, scale: float = 1.0) -> float:
    CALLS.append(scale)
    return scale * len(path.read_bytes())


@pytest.fixture(autouse=True)
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("MAPWEAVE_CACHE_DIR", str(own_cache(tmp_path)))
    monkeypatch.setattr(kept, "LEAST", 0.0)
    CALLS.clear()
    BREAK_AT.clear()
    return tmp_path / "cache" / "parts"


def broken_after(work):
    with kept_parts():
        work()
        raise BrokenError


def stopped(work):
    with pytest.raises(BrokenError) as told:
        broken_after(work)
    return getattr(told.value, "__notes__", [])


def squares(executor=None):
    with kept_parts():
        return parts(square, [(1.0,), (2.0,), (3.0,)], executor)


@pytest.mark.parametrize("threads", [0, 1])
def test_a_run_that_broke_off_goes_on_where_it_was(store, threads, caplog):
    BREAK_AT.append(3.0)
    executor = ThreadPoolExecutor(threads) if threads else None
    with pytest.raises(BrokenError) as told:
        squares(executor)
    assert told.value.__notes__ == ["2 finished parts are kept: the same command goes on from there"]
    BREAK_AT.clear()
    CALLS.clear()
    assert squares(executor) == [1.0, 4.0, 9.0]
    assert CALLS == [3.0]
    assert caplog.messages == ["going on with the finished parts of a run that was stopped"]
    assert list(store.iterdir()) == []


@pytest.mark.usefixtures("store")
def test_what_a_user_has_to_mend_first_is_told():
    with pytest.raises(DataError) as told, kept_parts():  # noqa: PT012
        part(square, 2.0)
        raise DataError("robot 1 and robot 2 hold the same scans")
    assert told.value.__notes__ == ["1 finished part is kept: once this is mended, the same command goes on from there"]


def test_other_settings_another_file_and_another_version_are_other_parts(tmp_path, monkeypatch):
    log = tmp_path / "log"
    log.write_text("four")

    def again(**more):
        CALLS.clear()
        stopped(lambda: part(size, log, *more.values()))
        return len(CALLS)

    assert (again(), again(), again(scale=2.0)) == (1, 0, 1)
    log.write_text("three")
    assert (again(), again()) == (1, 0)
    monkeypatch.setattr(kept, "_sources", lambda: "another")
    assert again() == 1


def test_a_part_that_is_torn_is_made_anew(store):
    assert stopped(lambda: part(square, 2.0)) == ["1 finished part is kept: the same command goes on from there"]
    for file in store.iterdir():
        file.write_bytes(file.read_bytes()[:-3])
    assert squares() == [1.0, 4.0, 9.0]


def test_of_short_work_nothing_is_kept(store, monkeypatch):
    monkeypatch.setattr(kept, "LEAST", 10.0)
    assert stopped(lambda: part(square, 2.0)) == []
    assert list(store.iterdir()) == []


def test_what_cannot_be_known_again_is_worked_on_each_time(store):
    assert stopped(lambda: part(lambda: 3)) == []
    assert list(store.iterdir()) == []


def test_a_folder_that_others_may_write_to_is_not_used(store):
    store.mkdir(parents=True)
    store.chmod(0o777)
    assert stopped(lambda: part(square, 2.0)) == []
    assert list(store.iterdir()) == []


def test_old_parts_that_nobody_came_back_for_are_removed(store):
    stopped(lambda: part(square, 2.0))
    (old,) = store.iterdir()
    os.utime(old, (1.0, 1.0))
    squares()
    assert not old.exists()


PROGRESS = re.compile(r"mapweave: (compiling|.*\d %)")
AT_ONCE = "import mapweave.io.kept as kept; kept.LEAST = 0.0\n"
WAITS_AFTER_THREE = """
import sys

write, written = kept._Keeper._write, []


def wait_after_three(self, name, value):
    write(self, name, value)
    written.append(name)
    if len(written) == 3:
        print("three are kept", flush=True)
        sys.stdin.readline()


kept._Keeper._write = wait_after_three
"""


def exploring(out, cache, *, waits=False):
    words = ["explore", "yuan", "--runs", "8", "--until", "3", "--out", str(out)]
    code = AT_ONCE + WAITS_AFTER_THREE * waits + f"from mapweave.cli import main; main({words!r})"
    env = {**os.environ, "MAPWEAVE_CACHE_DIR": str(cache)}
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, "-c", code], env=env, text=True, **pipes)  # noqa: S603


def without_progress(err):
    """What a run says besides how far it is, and that it compiles, which only the first one does."""
    return "".join(line for line in err.splitlines(keepends=True) if not PROGRESS.match(line))


def told_of(out):
    """What a run tells, but for the clock's part of it."""
    metrics = json.loads((out / "metrics.json").read_text())
    metrics.pop("timing", None)
    for each in (metrics["summary"], *metrics["runs"]):
        each.pop("ms_per_decision", None)
    return metrics


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    going = exploring(folder / "out", own_cache(folder))
    assert without_progress(going.communicate(timeout=240)[1]) == ""
    return told_of(folder / "out")


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_runs_that_were_killed_or_interrupted_go_on_to_the_same_result(tmp_path, how, undisturbed):
    cache = tmp_path / "cache" / "parts"
    going = exploring(tmp_path / "out", tmp_path / "cache", waits=True)
    assert going.stdout.readline() == "three are kept\n"
    going.send_signal(how)
    err = without_progress(going.communicate(timeout=60)[1])
    assert not (tmp_path / "out").exists()
    if how == signal.SIGINT:
        assert going.returncode == 130
        assert err.startswith("mapweave: interrupted; ")
        assert err.endswith(" finished parts are kept: the same command goes on from there\n")
    assert len(list(cache.glob("[!.]*"))) == 3
    again = exploring(tmp_path / "out", tmp_path / "cache")
    said = without_progress(again.communicate(timeout=120)[1])
    assert said == "going on with the finished parts of a run that was stopped\n"
    assert list(cache.iterdir()) == []
    assert told_of(tmp_path / "out") == undisturbed
