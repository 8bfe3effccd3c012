"""Compiled kernels on disk: never stale, never a reason to fail."""

import os
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

    def ask():
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=environ, capture_output=True, text=True, check=False
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
    assert len(house.entries()) == len(before)
    assert not set(house.entries()) & set(before)


@pytest.mark.parametrize("end", [".nbi", ".nbc"])
@pytest.mark.parametrize("left", [0, 0.5])
def test_a_torn_entry_is_told_and_built_anew(house, end, left):
    house()
    entry = next(f for f in house.entries() if f.suffix == end)
    entry.write_bytes(entry.read_bytes()[: int(left * entry.stat().st_size)])
    value, hits, said = house()
    assert (value, hits) == (4.0, 0)
    assert said.count("built anew") == 1
    assert "Traceback" not in said
    assert house() == (4.0, 1, "")


def test_a_folder_that_cannot_hold_an_entry_costs_the_entry_alone(house):
    house()
    for entry in house.entries():
        entry.unlink()
        entry.with_suffix(entry.suffix).mkdir()  # where the entry would be written stands something else
    value, hits, said = house()
    assert (value, hits) == (4.0, 0)
    assert "not kept" in said
    assert "Traceback" not in said
