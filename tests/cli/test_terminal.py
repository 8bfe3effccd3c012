"""The command line on odd terminals: one line each, never a traceback."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mapweave.cli import _run, main, terminal
from mapweave.cli.terminal import Stage, progress
from mapweave.kernels.compiling import tell_compiled, tell_compiling

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


@pytest.mark.slow
@pytest.mark.parametrize("end", ["<&-", "</dev/null"])
def test_a_closed_stdin_is_no_trouble(end):
    done = shell(f"{SHELL} config explore {end}")
    assert (done.returncode, done.stderr) == (0, "")
    assert "[mission]" in done.stdout


@pytest.mark.slow
def test_a_reader_that_stops_after_one_line_ends_it_silently():
    for command in ("explore --help", "config explore --laser"):
        done = shell(f"{SHELL} {command} | head -1")
        assert done.stderr == ""
        assert done.stdout.count("\n") <= 1
        assert done.returncode == 0


@pytest.mark.slow
def test_a_closed_stdout_ends_silently():
    assert shell(f"{SHELL} config explore >&-").stderr == ""


@pytest.mark.parametrize(
    "end", [*(pytest.param(e, marks=pytest.mark.slow) for e in ("<&-", ">&-", "2>&-")), "<&- >&- 2>&-"]
)
def test_a_job_is_done_whatever_its_caller_closed(end, tmp_path):
    done = shell(f"{SHELL} simulate swarm --out {tmp_path / 'swarm.csv'} --robots 9 {end}")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "swarm.csv").read_text().count("\n") > 9


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_stdout_is_told_in_one_line():
    done = shell(f"{SHELL} config explore > /dev/full")
    assert done.returncode == 1
    assert done.stderr.startswith("mapweave: stdout: No space left")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_target_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("no folder\n", encoding="utf-8")
    done = run("simulate", "landmarks", "--out", tmp_path / "file" / "team", "--minutes", "0.1")
    assert done.returncode in {1, 2}
    assert done.stderr.startswith("mapweave: ")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_message_of_several_lines_becomes_one():
    done = run("locate", "a\nb.csv", "--out", "c")
    assert done.returncode == 1
    assert done.stderr == "mapweave: a b.csv: no such file\n"


def told(capsys, line):
    """What stderr shows until `line`, a pattern, ends it."""
    err, until = "", time.monotonic() + 60
    while not re.search(line + r"\n\Z", err):
        assert time.monotonic() < until, err
        time.sleep(0.01)
        err += capsys.readouterr().err
    return err


def test_without_a_terminal_a_line_now_and_then_tells_how_far_it_is(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "QUIET", 0.02)
    with progress() as on_progress:
        on_progress("robots", 1, 4)
        told(capsys, "mapweave: robots, 25 %")
        on_progress("robots", 2, 4)
        told(capsys, r"mapweave: robots, 50 %, about \d+ s left")
        on_progress("robots", 4, 4)
        told(capsys, r"mapweave: after robots, \d+ s")
        on_progress("figures", 0, 4)
        told(capsys, "mapweave: figures, 0 %")


def test_short_work_without_a_terminal_is_silent(capsys):
    with progress() as on_progress:
        on_progress("robots", 1, 4)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("stage", "line"),
    [
        (Stage("reading", 100.0), "reading, 20 s"),
        (Stage("scans", 100.0, 0.0, 25.0, 100.0), "scans, 25 %, about 60 s left"),
        (Stage("scans", 100.0, 20.0, 30.0, 1000.0), "scans, 3 %, about 32 min left"),
        (Stage("scans", 100.0, 1.0, 2.0, 1000.0), "scans, 0 %, about 5.5 h left"),
        (Stage("scans", 100.0, 5.0, 5.0, 10.0), "scans, 50 %"),
    ],
)
def test_the_time_left_follows_from_the_pace_so_far(stage, line):
    assert stage.line(120.0) == line


def test_compiling_is_told_when_it_compiles_and_only_then(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "QUIET", 0.02)
    with progress() as on_progress:
        on_progress("robots", 1, 4)
        assert "compiling" not in told(capsys, "robots, 25 %")
        tell_compiling("cast")
        tell_compiling("which cast calls")
        tell_compiled("which cast calls")
        told(capsys, r"mapweave: compiling \(first run only\), \d+ s")
        tell_compiled("cast")
        told(capsys, "mapweave: robots, 25 %")


@pytest.mark.slow
def test_a_kernel_that_is_kept_is_not_compiled_again_and_no_garbage_is_looked_for_meanwhile(tmp_path):
    code = (
        "import gc, sys\nfrom mapweave.kernels.compiling import compiling_told\n"
        "from mapweave.kernels._jit import kernel\nsys.path.insert(0, sys.argv[1])\nfrom twice import twice\n"
        "told = []\nwith compiling_told(lambda now: told.append((now, gc.isenabled()))): twice(2.0)\n"
        "print(told, gc.isenabled())"
    )
    (tmp_path / "twice.py").write_text(
        "from mapweave.kernels._jit import kernel\n\n\n@kernel\ndef twice(x):\n    return 2 * x\n"
    )
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    words = [sys.executable, "-c", code, str(tmp_path)]
    told = [subprocess.run(words, env=env, capture_output=True, text=True, check=True).stdout for _ in range(2)]  # noqa: S603
    assert told == ["[(True, False), (False, False)] True\n", "[] True\n"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["locate", "s.csv"], "mapweave: locate: --out is missing; mapweave locate --help tells what it is\n"),
        (["simulate", "swarm"], "mapweave: simulate swarm: --out is missing; "),
        (["locate", "--out", "x"], "mapweave: locate: SIGHTINGS is missing; "),
        (["locate", "s.csv", "--sigma", "-1deg"], "mapweave: --sigma: -1deg reads as an option; a value that begins "),
        (["locate", "s.csv", "--sigma"], "mapweave: locate: --sigma is missing; "),
    ],
)
def test_what_a_command_was_not_given_is_named(capsys, words, told):
    assert _run(words) == 2
    assert capsys.readouterr().err.startswith(told)


@pytest.mark.parametrize("command", [["locate"], ["map"], ["simulate", "corridor"]])
def test_sentences_of_the_help_end_where_the_terminal_does(capsys, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "3000")
    assert _run([*command, "--help"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert lines
    assert [line for line in lines if not re.match(r"│ (\* )? *(-|[A-Z]{3})", line)] == []
