"""Results appear whole: at every moment the old one or the new one, whatever happens to whoever writes it."""

import errno
import os
import subprocess
import sys

import pytest

from mapweave.core.errors import UsageError
from mapweave.io import directory
from mapweave.io.directory import check_target, result_directory, result_file

KILLED = """
import os, random, signal, sys, time
from pathlib import Path
from mapweave.io.directory import result_directory

out, rng = Path(sys.argv[1]), random.Random(5)

def write(value):
    with result_directory(out) as work:
        for k in range(20):
            (work / f"f{k}").write_text(str(value))
        (work / "metrics.json").write_text('{"version": 1}')

write(0)
seen = set()
for kill in range(60):
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        for value in range(1, 10**9):
            write(f"{kill} {value}")
            os.write(theirs, b".")
        os._exit(0)
    os.read(ours, 1)
    time.sleep(rng.uniform(0.0, 0.01))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(ours)
    os.close(theirs)
    assert len(list(out.iterdir())) == 21
    now = {(out / f"f{k}").read_text() for k in range(20)}
    assert len(now) == 1, now
    seen |= now
assert len(seen) == 60, seen
print(sum(".unfinished-" in p.name for p in out.parent.iterdir()))
"""


def fill(work, text):
    (work / "a").write_text(text)
    (work / "metrics.json").write_text('{"version": 1}')


def test_a_process_killed_at_any_moment_leaves_the_old_result_or_the_new_one(tmp_path):
    words = [sys.executable, "-c", KILLED, str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)  # noqa: S603
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 0, "no kill fell into the writing"


def test_what_a_killed_process_left_is_removed_by_the_next_and_what_somebody_writes_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(directory, "SETTLED", 0.0)
    left = tmp_path / ".out.unfinished-1"
    left.mkdir()
    (left / "half").write_text("x")
    torn = tmp_path / ".out.unfinished-2"
    torn.write_text("x")
    other = tmp_path / ".outer.unfinished-3"
    other.mkdir()
    with result_directory(tmp_path / "out") as first:
        assert not left.exists()
        assert not torn.exists()
        fill(first, "1")
        with result_directory(tmp_path / "out") as second:
            assert first.exists()
            fill(second, "2")
    assert (tmp_path / "out" / "a").read_text() == "1"  # the last to finish stays
    assert sorted(p.name for p in tmp_path.iterdir()) == [".outer.unfinished-3", "out"]


def test_where_names_cannot_be_exchanged_the_result_is_replaced_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(directory, "_exchange_call", lambda: None)
    for text in "12":
        with result_directory(tmp_path / "out") as work:
            fill(work, text)
    assert (tmp_path / "out" / "a").read_text() == "2"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_two_processes_on_one_target_leave_one_whole_result(tmp_path):
    code = KILLED.split("write(0)", maxsplit=1)[0] + "for k in range(200): write(sys.argv[2])"
    words = [sys.executable, "-c", code, str(tmp_path / "out")]
    both = [subprocess.Popen([*words, name], stderr=subprocess.PIPE, text=True) for name in "ab"]  # noqa: S603
    assert [(p.communicate(timeout=120)[1], p.returncode) for p in both] == [("", 0), ("", 0)]
    assert {(tmp_path / "out" / f"f{k}").read_text() for k in range(20)} in ({"a"}, {"b"})
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("kind", [result_directory, result_file])
def test_a_full_disk_names_the_target_and_leaves_what_was_there(tmp_path, kind):
    def full(k):
        with kind(tmp_path / "out") as work:
            (fill(work, "new") if kind is result_directory else work.write_text("new"))
            if k:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(work / "a") if k > 1 else None)

    full(0)
    for k in (1, 2):
        with pytest.raises(OSError, match="No space left") as told:
            full(k)
        assert told.value.filename == str(tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    held = tmp_path / "out" / "a" if kind is result_directory else tmp_path / "out"
    assert held.read_text() == "new"


def test_a_target_whose_name_is_as_long_as_names_may_be_is_written(tmp_path):
    out = tmp_path / ("\u00e4" * 125)
    with result_directory(out) as work:
        fill(work, "1")
    assert (out / "a").exists()


def test_a_target_below_a_file_is_bad_usage(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="not a directory"):
        check_target(tmp_path / "file" / "a" / "b")


def test_a_target_that_holds_what_is_read_is_bad_usage_even_by_force(tmp_path):
    out = tmp_path / "out"
    (out / "recording").mkdir(parents=True)
    (out / "metrics.json").write_text('{"version": 1}')
    (tmp_path / "link").symlink_to(out)
    check_target(out, reads=(tmp_path / "log", str(tmp_path), None, {"t": [0.0]}))
    for read in (out, str(out / "recording"), tmp_path / "link" / "recording"):
        for force in (False, True):
            with pytest.raises(UsageError, match="the result would replace it"):
                check_target(out, force=force, reads=(tmp_path / "log", read))


def test_what_a_living_process_holds_is_held_and_is_not_when_it_is_killed(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from mapweave.io.directory import held\n"
        "with held(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    words = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as going:  # noqa: S603
        assert going.stdout.readline() == "held\n"
        assert directory.is_held(tmp_path)
        going.kill()
    assert not directory.is_held(tmp_path)
