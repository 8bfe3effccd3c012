"""A log format, a scan matcher and a planner of somebody else's, each a package of one file, installed and used."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.core import plugins
from mapweave.core.errors import UsageError
from mapweave.core.plugins import is_ours, plugged, plugged_in
from mapweave.exploration.planner_interface import find_planner
from mapweave.io.tum import read_tum
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

TOP = Path(__file__).resolve().parents[2]
PACKAGES = {"ring_log": 60, "nearest_points": 80, "zigzag": 20}  # and the most lines that each may have


def install(package, site):
    """`package` as `pip install` leaves it: its module, and the entry points of its metadata."""
    told = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    shutil.copy(package / f"{package.name}.py", site)
    info = site / f"{package.name}-{told['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {told['name']}\nVersion: {told['version']}\n")
    groups = [
        "\n".join([f"[{group}]", *(f"{name} = {where}" for name, where in named.items())])
        for group, named in told["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n\n".join(groups) + "\n")


@pytest.fixture(scope="module")
def mapweave_with_plugins(tmp_path_factory):
    """Runs the command line where all three packages are installed; gives what it prints."""
    site = tmp_path_factory.mktemp("site")
    for name in PACKAGES:
        install(TOP / "examples" / "plugins" / name, site)
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])

    def run(*words, code=0):
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-m", "mapweave", *map(str, words)],
            env=os.environ | {"PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    return run


@pytest.fixture(scope="module")
def drive():
    return simulate_corridor(CorridorConfig(distance=12.0), seed=3)


def off(folder, truth):
    """How far the trajectory of a result is from the truth at most [m], both from their first poses."""
    made = read_tum(next(folder.glob("**/robot1.tum"), None) or next(folder.glob("**/*.tum")))
    k = np.clip(np.searchsorted(truth.t, made.t), 0, len(truth.t) - 1)
    return float(np.linalg.norm(made.pose[:, :2] - truth.pose[k, :2], axis=1).max())


@pytest.mark.parametrize(("name", "most"), PACKAGES.items())
def test_what_is_plugged_in_is_one_short_file(name, most):
    assert len((TOP / "examples" / "plugins" / name / f"{name}.py").read_text().splitlines()) <= most


def test_doctor_tells_what_is_plugged_in_and_whose_it_is(mapweave_with_plugins):
    told = json.loads(mapweave_with_plugins("doctor", "--json"))["plugins"]
    assert told["readers"] == {"carmen": "", "stampless": "", "wean": "", "wheel-ticks": "", "ring": "ring-log 0.1"}
    assert told["matchers"] == {"lines": "", "nearest-points": "nearest-points 0.1"}
    assert told["planners"]["laser.zigzag"] == told["planners"]["landmarks.zigzag"] == "zigzag 0.1"
    assert "readers: carmen, stampless, wean, wheel-ticks, ring (ring-log 0.1)" in mapweave_with_plugins("doctor")


@pytest.mark.slow
def test_a_log_of_a_format_that_is_plugged_in_is_mapped(mapweave_with_plugins, drive, tmp_path):
    first = drive.log.scans[0]
    rows = [f"RING {first.angle_min!r} {first.angle_increment!r} {first.range_max!r}"]
    for t, scan in zip(drive.log.scan_t.tolist(), drive.log.scans, strict=True):
        ranges = np.where(scan.hit, scan.ranges, 0.0)
        rows.append(" ".join(repr(float(v)) for v in [t, *scan.odometry, *ranges]))
    log = tmp_path / "drive.ring"
    log.write_text("\n".join(rows) + "\n")
    mapweave_with_plugins("map", log, "--out", tmp_path / "out", "--method", "gated")
    dark = tuple(replace(scan, intensities=None) for scan in drive.log.scans)
    same = mapweave.map(replace(drive.log, scans=dark, odometry=None), tmp_path / "same", method="gated")
    made = read_tum(next((tmp_path / "out").glob("**/*.tum")))
    assert np.allclose(made.pose, read_tum(next((tmp_path / "same").glob("**/*.tum"))).pose, atol=1e-6), same.summary()
    log.write_text("\n".join([*rows[:5], rows[5] + " x"]) + "\n")
    told = mapweave_with_plugins("map", log, "--out", tmp_path / "bad", code=1)
    assert "drive.ring:6: could not convert" in told


@pytest.mark.slow
def test_scans_are_matched_by_the_matcher_that_is_plugged_in(mapweave_with_plugins, drive, tmp_path):
    from mapweave.io.mcap import write_mcap

    write_mcap(tmp_path / "drive.mcap", drive.log, drive.truth, range_min=0.1)
    asked = ("map", tmp_path / "drive.mcap", "--method", "gated", "--config", tmp_path / "mine.toml", "--out")
    (tmp_path / "mine.toml").write_text('[laser.front_end]\nmatcher = "nearest-points"\n')
    mapweave_with_plugins(*asked, tmp_path / "out")
    assert off(tmp_path / "out", drive.truth) < 0.2
    (tmp_path / "mine.toml").write_text('[laser.front_end]\nmatcher = "lasso"\n')
    told = mapweave_with_plugins(*asked, tmp_path / "none", code=2)
    assert "front_end.matcher: expected one of lines, nearest-points, found 'lasso'" in told


@pytest.mark.parametrize("world", ["yuan", pytest.param("office", marks=pytest.mark.slow)])
def test_a_team_drives_by_the_planner_that_is_plugged_in(mapweave_with_plugins, world, tmp_path):
    asked = ("explore", world, "--out", tmp_path / "out", "--until", "3", "--planner")
    mapweave_with_plugins(*asked, "zigzag")
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["planner"] == "zigzag"


def test_ours_are_registered_as_everybody_elses_and_come_first():
    told = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]["entry-points"]
    for kind in plugins.KINDS:
        there = {name: one.value for name, one in plugged(kind).items() if is_ours(one)}
        assert there == told[f"mapweave.{kind}"]
        assert all(one.load() is not None for one in plugged(kind).values())


def test_what_cannot_be_loaded_or_is_not_registered_is_told_by_name(monkeypatch):
    broken = [
        *entry_points(group="mapweave.planners"),
        plugins.EntryPoint("laser.lost", "no.where:at", "mapweave.planners"),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: broken if group.endswith("planners") else [])
    plugged.cache_clear()
    try:
        with pytest.raises(UsageError, match=r"mapweave.planners 'laser.lost': no.where:at cannot be loaded"):
            find_planner("lost", "laser")
        with pytest.raises(UsageError, match="the readers of mapweave are not registered: install it anew"):
            plugged_in("readers", "carmen", "--reader")
    finally:
        plugged.cache_clear()
