"""The import contract of pyproject.toml fails where it should: shown on a skeleton of the house with one sin each."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("importlinter")
TOP = Path(__file__).resolve().parent.parent
HOUSE = TOP / "src" / "mapweave"
LAYERS, NUMBA, ROOT = "Imports run downward only", "Numba lives in kernels alone", "The root package is imported"


@pytest.fixture
def lint(tmp_path):
    """Verdict of each contract, 'KEPT' or 'BROKEN', once `module` of the skeleton holds `line`."""
    skeleton = tmp_path / "mapweave"
    for room in [HOUSE, *(p.parent for p in HOUSE.glob("*/__init__.py"))]:
        (skeleton / room.relative_to(HOUSE)).mkdir(parents=True)
        (skeleton / room.relative_to(HOUSE) / "__init__.py").touch()
        (skeleton / room.relative_to(HOUSE) / "idea.py").touch()
    (skeleton / "idea.py").unlink()
    for name in ("_jit", "_cache"):
        (skeleton / "kernels" / f"{name}.py").write_text("import numba\n")
    shutil.copy(HOUSE / "__main__.py", skeleton)
    shutil.copy(TOP / "pyproject.toml", tmp_path)

    def lint(module="core/idea.py", line=""):
        file = skeleton / module
        file.parent.mkdir(exist_ok=True)
        (file.parent / "__init__.py").touch()
        file.write_text(line + "\n")
        done = subprocess.run(
            [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()", "--no-cache"],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path), "NO_COLOR": "1", "COLUMNS": "200"},
            capture_output=True,
            text=True,
            check=False,
        )
        said = done.stdout + done.stderr
        verdicts = re.findall(rf"^({LAYERS}|{NUMBA}|{ROOT}).* (KEPT|BROKEN)", said, re.MULTILINE)
        assert len(verdicts) == 3, said
        broken = {name for name, verdict in verdicts if verdict == "BROKEN"}
        assert bool(done.returncode) == bool(broken)
        return broken

    return lint


def test_the_house_as_it_stands_keeps_every_contract(lint):
    assert lint() == set()


def test_a_new_room_needs_a_place_in_the_layers(lint):
    assert lint("attic/idea.py", "") == {LAYERS}
    assert lint("cellar.py", "") == {LAYERS}


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("core/idea.py", "from ..landmarks import idea"),
        ("kernels/idea.py", "from ..core import idea"),
        ("landmarks/idea.py", "from mapweave.laser import idea"),
        ("api/idea.py", "def late():\n    from ..cli import idea"),
    ],
)
def test_an_import_upward_or_sideways_is_refused(lint, module, line):
    assert lint(module, line) == {LAYERS}


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("core/idea.py", "import numba"),
        ("kernels/idea.py", "from numba import njit"),
        ("cli/idea.py", "def late():\n    import numba.core"),
        ("__init__.py", "import numba"),
    ],
)
def test_numba_is_refused_outside_its_one_place(lint, module, line):
    assert lint(module, line) == {NUMBA}


def test_numba_is_refused_in_a_new_module_of_the_root(lint):
    assert lint("foo.py", "import numba") == {LAYERS, NUMBA}


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("core/idea.py", "import mapweave"),
        ("laser/__init__.py", "import mapweave"),
        ("exploration/idea.py", "from .. import __version__"),
        ("api/idea.py", "def late():\n    from mapweave import map"),
    ],
)
def test_the_root_package_is_refused_to_every_room_below_the_command_line(lint, module, line):
    assert lint(module, line) == {ROOT}


def test_the_command_line_may_import_the_root_package(lint):
    assert lint("cli/idea.py", "import mapweave") == set()
