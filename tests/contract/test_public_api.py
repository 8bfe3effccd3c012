"""What `import mapweave` offers."""

import gc
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

import mapweave
import mapweave.evaluation.team
import mapweave.fusion.join
from mapweave.api import map_options
from mapweave.cli import _run
from mapweave.fusion.config import Weights
from mapweave.laser.config import METHODS

VERBS = [name for name in mapweave._HOMES if name.islower()]
ROOMS = {path.name for path in Path(mapweave.__file__).parent.iterdir() if path.is_dir()}

HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydantic")


def test_every_public_name_can_be_had_and_is_listed():
    assert set(mapweave.__all__) == {*mapweave._HOMES, "__version__"}
    for name, home in mapweave._HOMES.items():
        assert getattr(mapweave, name) is getattr(import_module(f"mapweave.{home}"), name)
        assert name in dir(mapweave)
    assert all(callable(getattr(mapweave, name)) for name in VERBS)


def test_a_name_that_is_not_there_is_an_attribute_error_and_no_verb_hides_a_room():
    with pytest.raises(AttributeError, match="no attribute 'mapp'"):
        mapweave.mapp  # noqa: B018
    assert not ROOMS & set(mapweave._HOMES)
    assert callable(mapweave.fuse)
    assert callable(mapweave.fusion.join.fuse)


@pytest.mark.slow
def test_without_the_extra_every_name_is_there_and_those_of_a_live_team_say_what_is_missing():
    code = (
        "import sys\n"
        "sys.modules['zenoh'] = None\n"
        "from mapweave import *\n"
        "try:\n"
        "    live_robot('r1', 'LOG')\n"
        "except UsageError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout == "live_robot needs eclipse-zenoh: install mapweave with the extra [live]\n"


def test_importing_and_asking_for_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from mapweave.cli import _run\n"
        "for word in (['--help'], ['map', '--help'], ['simulate', 'landmarks', '--help'], ['demo', '--help']):\n"
        "    assert _run(word) == 0\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr.strip() == "[]"


def test_what_need_not_draw_imports_no_matplotlib():
    code = "import sys; from mapweave import *; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.strip() == "False"


def test_help_leaves_the_collector_as_it_was(capsys):
    assert gc.isenabled()
    assert _run(["--help"]) == 0
    assert gc.isenabled()
    gc.disable()
    try:
        assert _run([]) == 0
        assert not gc.isenabled()
    finally:
        gc.enable()
    assert capsys.readouterr().out.count("Usage: mapweave") == 2


def test_an_option_of_map_that_cannot_be_is_refused_before_anything_heavy_is_imported(tmp_path):
    refused = (
        ("--weights", "wrong"),
        ("--method", "wrong"),
        ("--seed", "-1"),
        ("--jobs", "0"),
        ("--truth", "missing"),
        ("--config", "missing.toml"),
        ("--start", "1:0,0"),
    )
    code = (
        "import sys\n"
        "from mapweave.cli import _run\n"
        f"for words in {[*refused, ()]!r}:\n"
        "    log = '.' if words else 'missing'\n"
        "    assert _run(['map', log, '--out', 'result', *words]) != 0, words\n"
        f"print([m for m in {(*HEAVY, 'threadpoolctl')!r} if m in sys.modules])\n"
    )
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.strip() == "[]"
    told = done.stderr.splitlines()
    assert len(told) == len(refused) + 1
    assert all(words[0] in line or words[1] in line for words, line in zip(refused, told, strict=False))
    assert "missing: no such file or folder" in told[-1]
    assert list(tmp_path.iterdir()) == []


def test_map_refuses_early_what_its_methods_do_not_know_and_nothing_else():
    assert get_args(Weights) == map_options.WEIGHTS
    assert map_options.LASER_METHODS == METHODS
    for method in (*METHODS, *map_options.LANDMARK_METHODS):
        map_options.MapOptions(method=method).check()


def test_the_verbs_work_from_python(tmp_path):
    team = mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    assert len(team.robots) == 2
    result = mapweave.map(tmp_path / "team", truth=tmp_path / "team")
    assert result.maps[0].robots == ("robot1", "robot2")
    assert result.score.landmarks.rmse < 1.0
    assert not (tmp_path / "result").exists()
