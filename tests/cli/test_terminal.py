"""The command line on odd terminals: one line each, never a traceback."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mapweave.cli import main

COMMAND = (sys.executable, "-m", "mapweave")
SHELL = f"{sys.executable} -m mapweave"


def run(*words, **more):
    env = {**os.environ, **more.pop("env", {})}
    return subprocess.run(  # noqa: S603
        [*COMMAND, *map(str, words)], capture_output=True, text=True, timeout=300, check=False, env=env, **more
    )


def shell(line, **env):
    """Exit status, stdout and stderr of a line of shell."""
    return subprocess.run(  # noqa: S603
        ["bash", "-o", "pipefail", "-c", line],  # noqa: S607
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, **env},
    )


def test_the_version_is_one_line():
    done = run("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    assert done.stdout.startswith("mapweave ")


@pytest.mark.parametrize("end", ["<&-", "</dev/null"])
def test_a_closed_stdin_is_no_trouble(end):
    done = shell(f"{SHELL} config map {end}")
    assert (done.returncode, done.stderr) == (0, "")
    assert "[ekf]" in done.stdout


def test_a_reader_that_stops_after_one_line_ends_it_silently():
    for command in ("explore --help", "config explore --laser"):
        done = shell(f"{SHELL} {command} | head -1")
        assert done.stderr == ""
        assert done.stdout.count("\n") <= 1
        assert done.returncode == 0


def test_a_closed_stdout_ends_silently():
    assert shell(f"{SHELL} config map >&-").stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_stdout_is_told_in_one_line():
    done = shell(f"{SHELL} config map > /dev/full")
    assert done.returncode == 1
    assert done.stderr.startswith("mapweave: stdout: No space left")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("env", [{"LANG": "C", "LC_ALL": "C"}, {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}])
def test_a_terminal_without_letters_shows_what_it_can(env, tmp_path):
    name = tmp_path / "s\u00e4le.csv"
    done = run("simulate", "swarm", "--out", name, "--robots", "9", env=env)
    assert (done.returncode, done.stderr) == (0, "")
    assert name.exists()
    done = run("locate", tmp_path / "fehlt\u00b2.csv", "--out", tmp_path / "out", env=env)
    assert done.returncode == 1
    assert done.stderr.startswith("mapweave: ")
    assert done.stderr.count("\n") == 1


def test_interrupted_it_ends_with_130_one_line_and_nothing_half_written(tmp_path):
    words = ["explore", "yuan", "--runs", "200", "--until", "landmarks", "--out", str(tmp_path / "out")]
    code = f"from mapweave.cli import main; print('ready', flush=True); main({words!r})"
    going = subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert going.stdout.readline() == "ready\n"
    time.sleep(3.0)
    assert going.poll() is None
    going.send_signal(signal.SIGINT)
    out, err = going.communicate(timeout=60)
    assert (going.returncode, out, err) == (130, "", "mapweave: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_that_a_callback_swallowed_is_one_all_the_same(monkeypatch, capsys):
    def swallow(tokens, interruption):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr("mapweave.cli._run", swallow)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit) as done:
        main([])
    assert done.value.code == 130
    assert capsys.readouterr().err == "mapweave: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is before


def test_a_target_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("no folder\n", encoding="utf-8")
    done = run("simulate", "landmarks", "--out", tmp_path / "file" / "team", "--minutes", "0.1")
    assert done.returncode in {1, 2}
    assert done.stderr.startswith("mapweave: ")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


def test_a_message_of_several_lines_becomes_one():
    done = run("locate", "a\nb.csv", "--out", "c")
    assert done.returncode == 1
    assert done.stderr == "mapweave: a b.csv: no such file\n"
