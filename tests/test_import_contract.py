"""The import contract of pyproject.toml fails where it should: shown on a skeleton of the house with one sin each."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from contract import offences

lint_imports = pytest.importorskip("importlinter.cli").lint_imports
TOP = Path(__file__).resolve().parent.parent
HOUSE = TOP / "src" / "mapweave"
LAYERS, NUMBA, ROOT = "Imports run downward only", "Numba lives in kernels alone", "The root package is imported"


@pytest.fixture
def lint(tmp_path, capsys):
    """Verdict of each contract, 'KEPT' or 'BROKEN', once `module` of the skeleton holds `line`."""
    skeleton = tmp_path / "mapweave"
    for room in [HOUSE, *(p.parent for p in HOUSE.glob("*/__init__.py"))]:
        (skeleton / room.relative_to(HOUSE)).mkdir(parents=True)
        (skeleton / room.relative_to(HOUSE) / "__init__.py").touch()
        (skeleton / room.relative_to(HOUSE) / "idea.py").touch()
    (skeleton / "idea.py").unlink()
    for name in ("_jit",):
        (skeleton / "kernels" / f"{name}.py").write_text("import numba\n")
    shutil.copy(HOUSE / "__main__.py", skeleton)
    shutil.copy(TOP / "pyproject.toml", tmp_path)

    def lint(module="core/idea.py", line=""):
        file = skeleton / module
        file.parent.mkdir(exist_ok=True)
        (file.parent / "__init__.py").touch()
        file.write_text(line + "\n")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path)
            patch.syspath_prepend(tmp_path)
            patch.delitem(sys.modules, "mapweave", raising=False)  # the house that tests run, where it is imported
            code = lint_imports(no_cache=True)
        said = capsys.readouterr().out
        verdicts = re.findall(rf"^({LAYERS}|{NUMBA}|{ROOT}).* (KEPT|BROKEN)", said, re.MULTILINE)
        assert len(verdicts) == 3, said
        broken = {name for name, verdict in verdicts if verdict == "BROKEN"}
        assert bool(code) == bool(broken)
        return broken

    return lint


def test_the_house_as_it_stands_keeps_every_contract(lint):
    assert lint() == set()


@pytest.mark.parametrize(
    ("module", "line", "broken"),
    [
        ("attic/idea.py", "", {LAYERS}),  # a new room needs a place in the layers
        ("cellar.py", "", {LAYERS}),
        ("core/idea.py", "from ..landmarks import idea", {LAYERS}),
        ("kernels/idea.py", "from ..core import idea", {LAYERS}),
        ("landmarks/idea.py", "from mapweave.laser import idea", {LAYERS}),
        ("api/idea.py", "def late():\n    from ..cli import idea", {LAYERS}),
        ("core/idea.py", "import numba", {NUMBA}),
        ("kernels/idea.py", "from numba import njit", {NUMBA}),
        ("cli/idea.py", "def late():\n    import numba.core", {NUMBA}),
        ("__init__.py", "import numba", {NUMBA}),
        ("foo.py", "import numba", {LAYERS, NUMBA}),
        ("core/idea.py", "import mapweave", {ROOT}),
        ("laser/__init__.py", "import mapweave", {ROOT}),
        ("exploration/idea.py", "from .. import __version__", {ROOT}),
        ("api/idea.py", "def late():\n    from mapweave import map", {ROOT}),
        ("cli/idea.py", "import mapweave", set()),
    ],
)
def test_each_sin_breaks_its_contract_and_no_other(lint, module, line, broken):
    assert lint(module, line) == broken


@pytest.fixture
def sinned(tmp_path):
    """What is told of a skeleton of the house in which one module says one thing more."""
    skeleton = tmp_path / "mapweave"
    for room in (p.parent for p in HOUSE.glob("*/__init__.py")):
        (skeleton / room.name).mkdir(parents=True)
        for name in ("__init__", "idea", "other", "_own"):
            (skeleton / room.name / f"{name}.py").touch()
    (skeleton / "live" / "transport.py").write_text("import zenoh\n")

    def sinned(module, line):
        path = skeleton / module
        path.write_text(path.read_text() + line + "\n" if path.exists() else line + "\n")
        return [re.sub(r":\d+:", ":", one) for one in offences(skeleton, TOP / "pyproject.toml")]

    return sinned


ZENOH = "api.idea: zenoh.ext is imported in live.transport alone"
DRAWN = "papers.idea: matplotlib.axes is imported in report.style alone"
CHECKED = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    "


@pytest.mark.parametrize(
    ("module", "line", "told"),
    [
        ("core/idea.py", "from ..landmarks import idea", "core.idea: landmarks stands above"),
        ("core/idea.py", "from ..landmarks.idea import Map", "core.idea: landmarks stands above"),
        ("laser/idea.py", "def late():\n    from ..api import idea", "laser.idea: api stands above"),
        ("laser/idea.py", f"{CHECKED}from ..mapping import idea", "laser.idea: mapping stands above"),
        ("fusion/idea.py", "import_module('mapweave.team.idea')", "fusion.idea: team stands above"),
        ("fusion/idea.py", "PLACE = 'mapweave.team.idea:make'", "fusion.idea: team stands above"),
        ("fusion/idea.py", "importlib.import_module('.team.idea', NAME)", "fusion.idea: team stands above"),
        ("fusion/idea.py", "import mapweave.team.idea", "fusion.idea: team stands above"),
        ("laser/idea.py", "from ..swarm import idea", "laser.idea: swarm is a sister room"),
        ("io/idea.py", f"{CHECKED}from ..sim.idea import World", "io.idea: sim is a sister room"),
        ("papers/idea.py", "from ..swarm.idea import _inner", "papers.idea: _inner is swarm's own"),
        ("live/idea.py", "from ..fusion import _own", "live.idea: _own is fusion's own"),
        ("exploration/idea.py", "from ..laser._own import Beam", "exploration.idea: _own is laser's own"),
        ("live/idea.py", "import zenoh", "live.idea: zenoh is imported in live.transport alone"),
        ("api/idea.py", "def late():\n    from zenoh.ext import z", ZENOH),
        ("papers/idea.py", f"{CHECKED}from matplotlib.axes import Axes", DRAWN),
        ("report/idea.py", "import matplotlib", "report.idea: matplotlib is imported in report.style alone"),
        ("api/idea.py", "import_module('rerun')", "api.idea: rerun is imported in viewer alone"),
        ("laser/idea.py", "import numba", "laser.idea: numba is imported in kernels._jit alone"),
        ("kernels/idea.py", "import numba", "kernels.idea: numba is imported in kernels._jit alone"),
        ("swarm/idea.py", "from ..sim import idea", "swarm.idea: sim stands above"),
        ("team/idea.py", "from ..evaluation import idea", "team.idea: evaluation stands above"),
        ("solve/idea.py", "open(name)", "solve.idea: an estimator opens a file"),
        ("laser/idea.py", "Path(name).read_text()", "laser.idea: an estimator opens a file"),
        ("laser/idea.py", "np.load(name)", "laser.idea: an estimator opens a file"),
        ("landmarks/idea.py", "t = time.time()", "landmarks.idea: an estimator reads a clock"),
        ("landmarks/idea.py", "from time import monotonic", "landmarks.idea: an estimator reads a clock"),
        ("mapping/idea.py", "print('done')", "mapping.idea: an estimator prints"),
        ("mapping/idea.py", "sys.stderr.write('done')", "mapping.idea: an estimator prints"),
    ],
)  # fmt: skip
def test_each_way_round_the_contract_is_caught(sinned, module, line, told):
    assert sinned(module, line) == [told]


@pytest.mark.parametrize(
    "line", ["from .other import a", "def late():\n    from . import other", f"{CHECKED}from .other import a"]
)
def test_a_circle_inside_a_room_is_caught(sinned, line):
    assert sinned("laser/other.py", "from .third import b\n") == []
    assert sinned("laser/third.py", "from .idea import c\n") == []
    assert sinned("laser/idea.py", line) == ["laser.idea <-> laser.other <-> laser.third: a circle"]


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("laser/idea.py", "from ._own import Beam\nfrom ..core import other\nfrom ..kernels.other import cast"),
        ("live/idea.py", "from .transport import Session\nimport time\nprint(time.time())"),
        ("io/idea.py", "open(name).read()"),
        ("report/style.py", "import matplotlib.pyplot"),
        ("mapping/idea.py", "graph.load(values)\nnow = clock.now"),
    ],
)
def test_what_a_room_may_do_is_no_offence(sinned, module, line):
    assert sinned(module, line) == []
