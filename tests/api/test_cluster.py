"""Logs worked on elsewhere: on a Dask cluster, or by any executor, with the bytes that working here gives."""

from concurrent.futures import ThreadPoolExecutor

import pytest

import mapweave
from mapweave.core.errors import UsageError
from tests.contract.test_landmark_job import run

distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


def files(folder):
    """All bytes but those that tell of time or are drawn."""
    kept = [
        p for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix in {".csv", ".tum", ".npz", ".pgm", ".g2o"}
    ]
    assert kept
    return {str(p.relative_to(folder)): p.read_bytes() for p in kept}


def test_landmark_logs_on_a_cluster_give_the_same_bytes(cluster, tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=3, landmarks=10, minutes=0.5, seed=4)
    for name, more in (("here", ()), ("there", ("--cluster", cluster.scheduler_address))):
        code, _, err = run("map", tmp_path / "team", "--out", tmp_path / name, *more)
        assert code == 0, err
    assert files(tmp_path / "here") == files(tmp_path / "there")
    with ThreadPoolExecutor(2) as pool:
        mapweave.map(tmp_path / "team", tmp_path / "threads", executor=pool)
    assert files(tmp_path / "here") == files(tmp_path / "threads")


def test_laser_logs_on_a_cluster_give_the_same_bytes(cluster, tmp_path):
    logs = []
    for k in (1, 2):
        assert run("simulate", "corridor", "--out", tmp_path / f"{k}.mcap", "--seed", k)[0] == 0
        logs.append(tmp_path / f"{k}.mcap")
    share = {"1": 0.05, "2": 0.05}
    mapweave.map(logs, tmp_path / "here", share=share)
    mapweave.map(logs, tmp_path / "there", share=share, cluster=cluster.scheduler_address)
    assert files(tmp_path / "here") == files(tmp_path / "there")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", "ftp://x:1"])
def test_an_address_where_no_scheduler_answers_is_one_error(address, tmp_path, monkeypatch):
    monkeypatch.setattr("mapweave.api.map.WAIT", 1.0)
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.1, seed=4)
    code, _, err = run("map", tmp_path / "team", "--out", tmp_path / "out", "--cluster", address)
    assert code == 2
    assert f"--cluster {address}: no Dask scheduler answers there" in err.splitlines()[-1]
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_cluster_and_an_executor_are_one_too_many(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.1, seed=4)
    with ThreadPoolExecutor(1) as pool, pytest.raises(UsageError, match="found both"):
        mapweave.map(tmp_path / "team", executor=pool, cluster="tcp://127.0.0.1:1")
