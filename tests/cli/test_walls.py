"""Runs against walls: a full disk, targets and caches that cannot be written, names that are no letters."""

import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mapweave.cli import _run, main

COMMAND = (sys.executable, "-m", "mapweave")
SHELL = f"{shlex.quote(sys.executable)} -m mapweave"


def run(*words, env=None, **more):
    return subprocess.run(  # noqa: S603
        [*COMMAND, *map(os.fsencode, words)], capture_output=True, timeout=300, check=False, env=env, **more
    )


def told(done, *parts):
    """The one line of a run that failed on its data."""
    assert done.returncode == 1, done.stderr
    line = done.stderr.decode(errors="surrogateescape")
    assert line.startswith("mapweave: ")
    assert line.count("\n") == 1
    assert all(part in line for part in parts), line


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world") / "team"
    words = ("--robots", "2", "--landmarks", "8", "--minutes", "0.2", "--seed", "4")
    with pytest.raises(SystemExit) as done:
        main(["simulate", "landmarks", "--out", str(folder), *words])
    assert done.value.code == 0
    return folder


def names(folder):
    return sorted(p.name for p in folder.iterdir())


@pytest.mark.slow
def test_a_full_disk_is_told_and_the_earlier_result_stays(team, tmp_path):
    out = tmp_path / "out"
    assert _run(["map", str(team), "--out", str(out)]) == 0
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    bare = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}  # a cut-off module would break every later run
    told(run("map", team, "--out", out, preexec_fn=small_disk, env=bare), f"{out}: cannot be written: ")
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before
    assert names(tmp_path) == ["out"]


def test_a_target_in_a_folder_that_is_read_only_is_refused_before_the_work(team, tmp_path, monkeypatch, capsys):
    (tmp_path / "held").mkdir(mode=0o555)
    allowed = os.access  # root may write everywhere
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "held" and allowed(path, mode))
    with pytest.raises(SystemExit) as done:
        main(["map", str(team), "--out", str(tmp_path / "held" / "out")])
    assert done.value.code == 2
    said = f"mapweave: {tmp_path}/held/out: cannot be written: no permission to write in {tmp_path}/held\n"
    assert capsys.readouterr().err == said


@pytest.mark.slow
def test_without_a_home_and_with_a_cache_that_cannot_be_written_a_team_is_mapped(team, tmp_path):
    (tmp_path / "file").write_text("no folder")
    env = {k: v for k, v in os.environ.items() if k not in {"HOME", "XDG_CACHE_HOME"}}
    env["NUMBA_CACHE_DIR"] = str(tmp_path / "file" / "cache")
    done = run("map", team, "--out", tmp_path / "out", "--no-refine", env=env)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
def test_names_that_are_no_letters_are_read_and_written(team, tmp_path):
    try:
        odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/t\xff\xfe"))
        shutil.copytree(team, odd)
    except OSError:
        pytest.skip("this file system holds letters alone")
    env = {**os.environ, "LANG": "C", "LC_ALL": "C"}
    out = odd.parent / "o\udcff"
    done = run("map", odd, "--out", out, env=env)
    assert (done.returncode, done.stderr) == (0, b"")
    assert os.fsencode(out) in done.stdout
    source = json.loads((out / "metrics.json").read_text(encoding="utf-8"))["robots"]["1"]["source"]
    assert b"t\xff\xfe" in os.fsencode(source)
    assert (out / "report.html").read_bytes().decode("utf-8")
    told(run("evaluate", out, "--truth", odd.parent / "none\udcff", env=env), "none")


@pytest.mark.slow
def test_a_reader_that_stops_after_one_line_of_a_summary_ends_it_silently(team, tmp_path):
    line = f"{SHELL} map {team} --out {tmp_path / 'out'} --no-refine | head -1"
    done = subprocess.run(  # noqa: S603
        ["bash", "-o", "pipefail", "-c", line],  # noqa: S607
        capture_output=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.count(b"\n") == 1
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
def test_closed_stdin_and_stdout_leave_a_whole_result(tmp_path):
    line = f"{SHELL} simulate landmarks --robots 2 --minutes 0.2 --out {tmp_path / 'out'} <&- >&-"
    done = subprocess.run(["bash", "-c", line], capture_output=True, timeout=300, check=False)  # noqa: S603, S607
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "out" / "simulation.json").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("landmarks --robots 1000000000", "--robots: expected at most 1,000, found 1,000,000,000"),
        ("landmarks --landmarks 1000000000", "--landmarks: expected at most 10,000, found"),
        ("landmarks --minutes 1e300", "--robots times --minutes: expected at most 10,000, found 3e+300"),
        ("team --cameras 1000000000", "--cameras: expected at most 200, found 1,000,000,000"),
        ("team --rooms 1000000", "--rooms: expected at most 200, found 1,000,000"),
        ("swarm.csv --robots 1000000000", "--robots: expected at most 1,000,000, found 1,000,000,000"),
        ("swarm.csv --steps 1000000000", "robots times steps times --k: expected at most 20,000,000, found"),
        ("office.mcap --rooms 1000000", "--rooms: expected at most 500, found 1,000,000"),
        ("office.mcap --beams 1000000000", "--beams: expected at most 20,000, found 1,000,000,000"),
        ("tunnel.mcap --length 1e308", "metres driven: expected at most 100,000, found"),
        ("corridor.mcap --distance 1e9", "metres driven: expected at most 100,000, found 1,000,000,000"),
        ("corridor.mcap --scan-every 1e-9", "scans: expected at most 200,000, found"),
        ("corridor.mcap --people 1000000000", "--people: expected at most 1,000, found 1,000,000,000"),
    ],
)
def test_a_simulated_world_beyond_all_use_is_refused_with_the_number(tmp_path, capsys, words, told):
    name, *options = words.split()
    assert _run(["simulate", name.split(".")[0], "--out", str(tmp_path / name), *options]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", [["explore"], ["explore", "yuan", "--config"]])
def test_a_file_of_brackets_in_brackets_is_one_line(tmp_path, capsys, option):
    (tmp_path / "deep.toml").write_text("walls = " + 20_000 * "[" + 20_000 * "]")
    assert _run([*option, str(tmp_path / "deep.toml"), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "nested too deeply" in told
    assert told.count("\n") == 1
