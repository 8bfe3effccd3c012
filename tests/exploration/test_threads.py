"""The same seed gives the same bytes, however many threads the libraries below use."""

import csv
import json
import os
import subprocess
import sys

import pytest

RUN = "import sys; from mapweave.api.explore import explore; explore(*sys.argv[1:], robots=2, until=25, seed=4)"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def explored(scenario, folder, threads):
    env = os.environ | dict.fromkeys(THREADS, str(threads))
    subprocess.run([sys.executable, "-c", RUN, scenario, str(folder)], env=env, check=True)  # noqa: S603  (our own code)
    return folder


def contents(folder):
    """Every file's bytes but those that tell the time: the page, result.npz, clocks in runs.csv and metrics.json."""
    out = {
        str(p.relative_to(folder)): p.read_bytes()
        for p in folder.rglob("*")
        if p.is_file() and p.name not in ("report.html", "result.npz", "runs.csv", "metrics.json")
    }
    rows = list(csv.DictReader((folder / "runs.csv").read_text(encoding="utf-8").splitlines()))
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    metrics.pop("timing", None)
    for row in (*rows, metrics["summary"], *metrics["runs"]):
        del row["ms_per_decision"]
    return out | {"runs.csv": rows, "metrics.json": metrics}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["office-200", "yuan"])
def test_one_thread_and_two_write_the_same_bytes(tmp_path, scenario):
    one, two = (contents(explored(scenario, tmp_path / str(n), n)) for n in (1, 2))
    assert one.keys() == two.keys()
    assert [name for name in one if one[name] != two[name]] == []
