"""Compiled kernels on disk: never stale, never a reason to fail."""

import os
import shutil
import subprocess
import sys

import pytest

CALLER = """
from mapweave.kernels._jit import kernel
from .callee import height

@kernel
def twice(x):
    return 2.0 * height(x)
"""
CALLEE = """
from mapweave.kernels._jit import kernel

@kernel
def height(x):
    return x + {constant}
"""
PROGRAM = """
from house.caller import twice
print(twice(1.0), sum(twice.stats.cache_hits.values()))
"""


@pytest.fixture
def house(tmp_path):
    """A package of two kernels, one of which calls the other; gives what `twice(1.0)` is in a new process."""
    package, cache = tmp_path / "house", tmp_path / "cache"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(CALLER)
    (package / "callee.py").write_text(CALLEE.format(constant=1.0))
    environ = os.environ | {"NUMBA_CACHE_DIR": str(cache), "NUMBA_DISABLE_JIT": "0"}

    def ask(program=PROGRAM, home=None):
        env = environ if home is None else environ | {"HOME": home, "XDG_CACHE_HOME": home, "MAPWEAVE_CACHE_DIR": home}
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-c", program], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        value, hits = done.stdout.split()
        return float(value), int(hits), done.stderr

    ask.package, ask.entries = package, lambda: sorted(cache.rglob("caller.twice*"))
    return ask


def test_an_edited_function_in_another_file_is_compiled_anew_into_its_caller(house):
    assert house()[:2] == (4.0, 0)
    assert house()[:2] == (4.0, 1)
    before = house.entries()
    (house.package / "callee.py").write_text(CALLEE.format(constant=2.0))
    assert house()[:2] == (6.0, 0)
    assert house()[:2] == (6.0, 1)
    assert set(house.entries()) > set(before), "another installation may hold the older sources"
    for entry in before:
        os.utime(entry, (0, 0))
    (house.package / "callee.py").write_text(CALLEE.format(constant=3.0))
    assert house()[:2] == (8.0, 0)
    assert not set(house.entries()) & set(before), "what nobody wrote for long is removed"


def test_two_installations_share_what_one_of_them_compiled(house, tmp_path):
    """Both without NUMBA_CACHE_DIR, the second in another place of the same sources."""
    own = {"MAPWEAVE_CACHE_DIR": str(tmp_path / "own"), "NUMBA_DISABLE_JIT": "0"}
    environ = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | own
    shutil.copytree(house.package, tmp_path / "elsewhere" / "house")

    def ask(home):
        command = [sys.executable, "-c", PROGRAM]
        return subprocess.run(command, cwd=home, env=environ, check=True, capture_output=True, text=True).stdout.split()  # noqa: S603

    assert [ask(tmp_path), ask(tmp_path / "elsewhere")] == [["4.0", "0"], ["4.0", "1"]]
    assert not list(tmp_path.rglob("__pycache__/*.nbi"))
    (tmp_path / "own" / "kernels").chmod(0o777)
    assert ask(tmp_path) == ["4.0", "0"], "what others may have written is not run"


def test_a_torn_entry_is_told_and_built_anew(house):
    house()
    for end, left in ((".nbi", 0.5), (".nbc", 0.5), (".nbi", 0), (".nbc", 0)):
        entry = next(f for f in house.entries() if f.suffix == end)
        entry.write_bytes(entry.read_bytes()[: int(left * entry.stat().st_size)])
        value, hits, said = house()
        assert (value, hits) == (4.0, 0), (end, left)
        assert said.count("built anew") == 1, (end, left)
        assert "Traceback" not in said
    assert house() == (4.0, 1, "")


@pytest.mark.slow
def test_a_folder_that_cannot_hold_an_entry_costs_the_entry_alone(house):
    house()
    for entry in house.entries():
        entry.unlink()
        entry.with_suffix(entry.suffix).mkdir()  # where the entry would be written stands something else
    value, hits, said = house()
    assert (value, hits) == (4.0, 0)
    assert "not kept" in said
    assert "Traceback" not in said


READ_ONLY = """
import tempfile

def refused(*_, **__):
    raise OSError(30, "Read-only file system")

tempfile.TemporaryFile = refused  # by which Numba tries whether a folder can be written
"""


def test_what_a_folder_holds_is_used_where_nothing_can_be_written(house):
    assert house()[:2] == (4.0, 0)
    assert house(READ_ONLY + PROGRAM) == (4.0, 1, "")


def test_without_any_folder_kernels_are_compiled_and_that_is_told_once(house, tmp_path):
    (tmp_path / "cache").touch()
    (house.package / "__pycache__").touch()
    value, hits, said = house(home="/dev/null")
    assert (value, hits) == (4.0, 0)
    assert said.count("MAPWEAVE_CACHE_DIR") == 1
    assert said.count("\n") == 1


REFINED = """
import hashlib
import numpy as np
from mapweave.kernels.laser.refine import ScanCost, refine
from mapweave.kernels.laser.tiles import NearestRule, TileMaps

rng = np.random.default_rng(1)
pool = rng.uniform(0.0, 1.6, 4 * 256).astype(np.float32)
table = rng.integers(0, 4, (6, 4)).astype(np.int32)
poses = np.column_stack([rng.uniform(0.5, 1.0, (60, 2)), rng.uniform(-3.0, 3.0, 60)])
points = np.column_stack([rng.uniform(-1.0, 1.0, (50, 2)), rng.uniform(0.0, 1.0, 50)])
normals = np.column_stack([np.cos(points[:, 0]), np.sin(points[:, 0])])
grid, rows = TileMaps(pool, table, 2, np.zeros(2), 0.1), rng.integers(0, 6, 60).astype(np.int32)
rule, cost = NearestRule(0.5, 1.0), ScanCost(1e3, 0.3, 0.1)
least = np.empty((60, 50), np.float32)
out = refine(grid, rows, poses, points, normals, rule, cost, 50.0 * np.eye(3), 4, least)
print(hashlib.sha256(out.tobytes()).hexdigest(), sum(refine.stats.cache_hits.values()))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled here")
def test_a_kernel_just_compiled_gives_the_bytes_of_the_one_on_disk(tmp_path):
    environ = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}

    def ask():
        command = [sys.executable, "-c", REFINED]
        return subprocess.run(command, env=environ, check=True, capture_output=True, text=True).stdout.split()  # noqa: S603

    (fresh, none), (kept, hits) = ask(), ask()
    assert (none, hits) == ("0", "1")
    assert fresh == kept
