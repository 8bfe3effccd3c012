"""Every example becomes a notebook, whose cells run one by one in a folder of their own and hold all of its script."""

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


# each cell on its own in one namespace, `__main__`, as a kernel runs it
CELLS = """
import json, sys
for cell in json.load(open(sys.argv[1], encoding="utf-8"))["cells"]:
    if cell["cell_type"] == "code":
        exec(compile(cell["source"], cell["id"], "exec"))
"""


@pytest.fixture(scope="module")
def notebooks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebooks")
    make_notebooks.main(folder)
    return folder


def run(path, folder):
    env = {**os.environ, "MPLBACKEND": "Agg"}
    return subprocess.run(  # noqa: S603
        [sys.executable, "-c", CELLS, str(path)],
        cwd=folder, capture_output=True, text=True, timeout=300, check=False, env=env,
    )  # fmt: skip


def test_every_example_is_short():
    assert all(len(path.read_text(encoding="utf-8").splitlines()) < 60 for path in SCRIPTS)


QUICK = {"swarm"}
EXAMPLES = [pytest.param(p, id=p.stem, marks=() if p.stem in QUICK else pytest.mark.slow) for p in SCRIPTS]


@pytest.mark.parametrize("path", EXAMPLES)
def test_a_notebook_prints_what_its_page_says_and_leaves_nothing_behind(path, notebooks, tmp_path):
    done = run(notebooks / f"{path.stem}.ipynb", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []
    page = (PAGES / f"{path.stem.replace('_', '-')}.md").read_text(encoding="utf-8")
    said, shown = (
        sorted(TIME.sub("", line) for line in lines) for lines in (done.stdout.splitlines(), recipes.printed(page))
    )
    assert words(said) == words(shown)
    assert numbers(said) == pytest.approx(numbers(shown), rel=0.1, abs=0.02)  # other processors round otherwise


@pytest.mark.slow
def test_maps_of_two_places_are_not_made_one(notebooks, tmp_path):
    said = run(notebooks / "fuse_results.ipynb", tmp_path).stdout
    assert "elsewhere/robot1: refused" in said
    assert "landmark RMSE 0." in said


def test_notebooks_hold_all_code_of_their_scripts_and_nothing_else(notebooks):
    assert len(list(notebooks.iterdir())) == len(SCRIPTS) == 12
    for path in SCRIPTS:
        made = json.loads((notebooks / f"{path.stem}.ipynb").read_text(encoding="utf-8"))
        assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
        assert len({cell["id"] for cell in made["cells"]}) == len(made["cells"])
        assert made["cells"][0]["source"].startswith("# ")
        code = [cell["source"] for cell in made["cells"] if cell["cell_type"] == "code"]
        whole = ast.parse(path.read_text(encoding="utf-8"))
        assert ast.dump(ast.parse("\n\n".join(code))) == ast.dump(ast.Module(whole.body[1:], []))
