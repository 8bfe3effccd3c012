"""`mapweave doctor` tells what mapweave runs on, and fails when it cannot run."""

import json
from dataclasses import replace

import pytest

import mapweave
from mapweave.api import doctor as module
from mapweave.api.doctor import Package, doctor
from mapweave.cli import _run


@pytest.fixture(scope="module")
def found():
    return doctor()


def test_it_tells_versions_extras_cores_and_a_kernels_time(found):
    told = found.summary()
    assert found.healthy
    for word in ("Python 3.", "numpy 2", "numba 0", "viewer", "parquet", "cores: ", "a kernel tried: first call"):
        assert word in told
    assert found.second < found.first or found.first < 0.01
    assert found.metrics["packages"]["numpy"]
    assert json.loads(json.dumps(found.metrics))["healthy"] is True


def test_what_is_missing_too_old_or_wrong_makes_it_unhealthy(found):
    for package in (Package("rich", "", "13.7", None), Package("rich", "", "13.7", "9.10.1")):
        ill = replace(found, packages=(*found.packages, package))
        assert not ill.healthy
        assert "MISSING" in ill.summary() or "TOO OLD, needs 13.7" in ill.summary()
    assert replace(found, packages=(*found.packages, Package("rerun-sdk", "viewer", "0.22", None))).healthy
    assert not replace(found, kernel_error="FAILED: no compiler").healthy
    assert "every run compiles anew" in replace(found, writable=False).summary()


def test_a_kernel_that_errs_or_cannot_be_compiled_ends_with_1(monkeypatch, capsys):
    true = module.cast
    monkeypatch.setattr(module, "cast", lambda *args: (true(*args)[0] + 0.1, None, None))
    assert _run(["doctor"]) == 1
    assert "FAILED: a wall at 2.0 m is seen 0.1 m off" in capsys.readouterr().out

    def broken(*_):
        raise RuntimeError("no compiler")

    monkeypatch.setattr(module, "cast", broken)
    assert _run(["doctor", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["kernel_error"] == "FAILED: no compiler"


def test_a_job_that_comes_out_wrong_or_fails_is_told_and_ends_with_1(monkeypatch, capsys):
    def failing(_):
        raise mapweave.DataError("no scans")

    trials = {"landmarks": lambda _: ("3 robots", True), "laser": failing, "swarm": lambda _: ("far off", False)}
    monkeypatch.setattr("mapweave.api.demo.TRIALS", trials)
    assert _run(["self-test"]) == 1
    told = capsys.readouterr().out
    assert told.startswith("landmarks: 3 robots\nlaser: FAILED: no scans (WRONG)\nswarm: far off (WRONG)\n")
    monkeypatch.setattr("mapweave.api.demo.TRIALS", {"landmarks": trials["landmarks"]})
    assert _run(["self-test", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["healthy"]


def test_all_well_ends_with_0(capsys):
    assert _run(["doctor"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("all is well")
