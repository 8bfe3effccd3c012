"""Results do not depend on how many threads the linear algebra might use."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from mapweave.core.workers import one_blas_thread

from .blas_threads import threads

ROOT = Path(__file__).parents[2]
NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
LOCATE = """
import mapweave, sys
from mapweave.sim.swarm import SwarmScene
made = mapweave.simulate_swarm(scene=SwarmScene(robots=3000), seed=1)
mapweave.locate(made.table, sys.argv[1], anchors={made.table.ids[c]: made.position[0][c] for c in made.corners})
"""


@pytest.fixture
def two():
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this BLAS knows no threads")
        yield


@pytest.mark.slow
def test_locate_writes_the_same_bytes_with_one_thread_and_with_two(tmp_path):
    found = []
    for count in ("1", "2"):
        out = tmp_path / count
        told = {**os.environ, **dict.fromkeys(NAMES, count)}
        subprocess.run([sys.executable, "-c", LOCATE, str(out)], check=True, env=told)  # noqa: S603
        found.append({name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in
                      ("positions.csv", "network.npz")})  # fmt: skip
    assert found[0] == found[1]


@pytest.mark.usefixtures("two")
def test_the_limit_holds_within_nests_and_is_lifted_after():
    @one_blas_thread()
    def inside():
        return threads()

    with one_blas_thread():
        assert threads() == {1}
        assert inside() == {1}
        assert threads() == {1}
    assert threads() == {2}
    assert inside() == {1}
    assert threads() == {2}
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        1 / 0  # noqa: B018
    assert threads() == {2}


def test_tasks_run_on_one_thread_in_an_executor_of_the_callers_and_in_processes_of_our_own():
    told = {**os.environ, **dict.fromkeys(NAMES, "2")}
    done = subprocess.run(
        [sys.executable, "-m", "tests.core.blas_threads"],
        check=True, env=told, cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    if done.stdout.startswith("before {1}"):
        pytest.skip("this BLAS knows no threads")
    assert done.stdout.split("\n") == [
        "before {2}", "theirs [{1}, {1}]", "submitted (3, 1)", "after {2}", "ours [{1}, {1}]", "here None", ""
    ]  # fmt: skip


def test_a_large_product_is_the_same_under_the_limit_whatever_stood_before():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(700, 700))
    products = []
    for count in (1, 2):
        with threadpool_limits(count, user_api="blas"), one_blas_thread():
            products.append((A @ A.T).tobytes())
    assert products[0] == products[1]
