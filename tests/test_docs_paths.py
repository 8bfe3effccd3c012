"""The documentation names files that are there, and functions and settings that the code has."""

import ast
import importlib.util
import re
from functools import cache
from pathlib import Path

import pytest

TOP = Path(__file__).parent.parent
SOURCE = TOP / "src" / "mapweave"
NAMED = re.compile(r"`((?:[a-z_]+/)+(?:[a-z_0-9]+\.py)?)`")
WALKED = re.compile(r"^\| `((?:[a-z]+/)+)`[^|]*\| ([^|]*)\| ([^|]*)\|$", re.MULTILINE)
PAGES = sorted([*TOP.glob("docs/**/*.md"), TOP / "README.md"])
CALLED = re.compile(r"`(?:\w+\.)*([a-z][a-z0-9]*(?:_[a-z0-9]+)+)(?:\([^`]*\))?`")
OTHERS = {"local_k", "small_gicp"}  # a frame, a library to compare with
FOLDERS_OF_RESULTS = {"trajectories/", "state/", "figures/", "log/", "recording/", "result/", "local/", "components/"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_file_and_folder_a_page_names_is_there(page):
    missing = [
        name
        for name in NAMED.findall(page.read_text(encoding="utf-8"))
        if not ((SOURCE / name).exists() or (TOP / name).exists() or name.split("/")[0] + "/" in FOLDERS_OF_RESULTS)
    ]
    assert not missing


@cache
def names() -> frozenset[str]:
    """What the code calls something: modules, functions, classes, arguments, attributes, and whole strings."""
    found = {path.stem for path in SOURCE.rglob("*.py")}
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for field in ("name", "arg", "attr", "id", "value"):
                value = getattr(node, field, None)
                if isinstance(value, str):
                    found.add(value)
    return frozenset(found)


@pytest.mark.parametrize("page", sorted(TOP.glob("docs/methods/*.md")), ids=lambda p: p.name)
def test_every_name_in_code_letters_on_a_method_page_is_in_the_code(page):
    assert [name for name in CALLED.findall(page.read_text(encoding="utf-8")) if name not in names() | OTHERS] == []


def test_a_name_that_no_code_has_would_be_found():
    assert CALLED.findall("`rls.replace_map` and `fuse_relative(maps)`") == ["replace_map", "fuse_relative"]
    assert "fuse_relative" in names()
    assert "replace_map" not in names()


def test_every_file_that_an_event_is_said_to_enter_is_in_that_folder():
    page = (TOP / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = [
        folder + name for folder, *cells in WALKED.findall(page) for c in cells for name in re.findall(r"`([^`]+)`", c)
    ]
    assert len(named) > 100
    assert not [name for name in named if not (SOURCE / name).is_file()]


def test_a_long_name_may_go_on_in_the_next_line_and_is_otherwise_as_it_was():
    pytest.importorskip("sphinx")
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location("docs_conf", TOP / "docs" / "conf.py")
    conf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(conf)
    page = '<code class="docutils literal"><span class="pre">{}</span></code>'
    context = {"body": page.format("solve/multifrontal_of.py")}
    conf.breakable(None, "", "", context, None)
    assert context["body"] == page.format("solve/<wbr>multifrontal_<wbr>of.py")
