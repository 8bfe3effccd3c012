"""Every example runs in a directory of its own, and becomes a notebook whose code runs too."""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import recipes

HERE = Path(__file__).resolve().parent.parent / "examples"
spec = importlib.util.spec_from_file_location("make_notebooks", HERE / "make_notebooks.py")
make_notebooks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make_notebooks)
SCRIPTS = make_notebooks.scripts()
PAGES = HERE.parent / "docs" / "recipes"
TIME = re.compile(r"[\d.]+ ms a decision")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def numbers(lines):
    return [float(number) for line in lines for number in NUMBER.findall(line)]


def words(lines):
    return [NUMBER.sub("#", line) for line in lines]


def run(path, folder):
    env = {**os.environ, "MPLBACKEND": "Agg"}
    return subprocess.run(  # noqa: S603
        [sys.executable, str(path)], cwd=folder, capture_output=True, text=True, timeout=300, check=False, env=env
    )


def test_every_example_is_short():
    assert all(len(path.read_text(encoding="utf-8").splitlines()) < 60 for path in SCRIPTS)


QUICK = {"swarm"}
EXAMPLES = [pytest.param(p, id=p.stem, marks=() if p.stem in QUICK else pytest.mark.slow) for p in SCRIPTS]


@pytest.mark.parametrize("path", EXAMPLES)
def test_an_example_prints_what_its_page_says_and_leaves_nothing_behind(path, tmp_path):
    done = run(path, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []
    page = (PAGES / f"{path.stem.replace('_', '-')}.md").read_text(encoding="utf-8")
    said, shown = (
        sorted(TIME.sub("", line) for line in lines) for lines in (done.stdout.splitlines(), recipes.printed(page))
    )
    assert words(said) == words(shown)
    assert numbers(said) == pytest.approx(numbers(shown), rel=0.1, abs=0.02)  # other processors round otherwise


@pytest.mark.slow
def test_maps_of_two_places_are_not_made_one(tmp_path):
    said = run(HERE / "fuse_results.py", tmp_path).stdout
    assert "elsewhere/robot1: refused" in said
    assert "landmark RMSE 0." in said


def test_notebooks_hold_all_code_of_their_scripts_and_nothing_else(tmp_path, capsys):
    make_notebooks.main(tmp_path)
    assert capsys.readouterr().out.count("\n") == len(SCRIPTS)
    for path in SCRIPTS:
        made = json.loads((tmp_path / f"{path.stem}.ipynb").read_text(encoding="utf-8"))
        assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
        assert len({cell["id"] for cell in made["cells"]}) == len(made["cells"])
        assert made["cells"][0]["source"].startswith("# ")
        code = [cell["source"] for cell in made["cells"] if cell["cell_type"] == "code"]
        whole = ast.parse(path.read_text(encoding="utf-8"))
        assert ast.dump(ast.parse("\n\n".join(code))) == ast.dump(ast.Module(whole.body[1:], []))


@pytest.mark.slow
def test_a_notebooks_code_runs_cell_by_cell(tmp_path):
    make_notebooks.main(tmp_path / "notebooks")
    made = json.loads((tmp_path / "notebooks" / "swarm.ipynb").read_text(encoding="utf-8"))
    script = tmp_path / "cells.py"
    script.write_text(
        "\n\n".join(cell["source"] for cell in made["cells"] if cell["cell_type"] == "code"), encoding="utf-8"
    )
    done = run(script, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "RMSE 0." in done.stdout
