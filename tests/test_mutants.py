"""The mutation run makes the mistakes that it names, each on one line, and knows where sources and tests live."""

import ast
import sys
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parent.parent


def loaded(name):
    """A script of benchmarks/, which finds its neighbours among the modules that are loaded."""
    spec = spec_from_file_location(name, TOP / "benchmarks" / f"{name}.py")
    sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


areas, finder, mutants = (loaded(name) for name in ("mutants_areas", "mutants_finder", "mutants"))

SOURCE = b'''"""Text about 1.5 - 2."""


def f(x: int = -1, *, axis: "a - b" = 0) -> "c * d":
    total = 0.0  # \xc3\xa4
    for k in range(x):
        if k < 3 and not x == 4:
            continue
        total += 2.5 * x[k - 1] - max(k, 0)
    if total > 1e9:
        return 0.0
    if total != total:
        raise ValueError(f"{x - 1}")
    return (A.T @ total.sum(axis=-1)) / np.clip(total, -1.0, 1.0)
'''


def lines():
    found = finder.Finder("f.py", SOURCE).mutants()
    return {(m.kind, m.apply(SOURCE).decode().splitlines()[m.line - 1].strip()) for m in found}


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("sign", 'def f(x: int = (1), *, axis: "a - b" = 0) -> "c * d":'),
        ("comparison", "if k >= 3 and not x == 4:"),
        ("condition", "if k < 3 or not x == 4:"),
        ("condition", "if k < 3 and (x == 4):"),
        ("lost exit", "pass"),
        ("arithmetic", "total -= 2.5 * x[k - 1] - max(k, 0)"),
        ("arithmetic", "total += 2.5 / x[k - 1] - max(k, 0)"),
        ("arithmetic", "total += 2.5 * x[k + 1] - max(k, 0)"),
        ("constant", "total += 25.0 * x[k - 1] - max(k, 0)"),
        ("lost term", "total += 2.5 * x[k - 1]"),
        ("lost term", "total += -(max(k, 0))"),
        ("lost bound", "total += 2.5 * x[k - 1] - (k)"),
        ("comparison", "if total == total:"),
        ("lost transpose", "return (A @ total.sum(axis=-1)) / np.clip(total, -1.0, 1.0)"),
        ("lost bound", "return (A.T @ total.sum(axis=-1)) / (total)"),
        ("arithmetic", "return (A.T @ total.sum(axis=-1)) * np.clip(total, -1.0, 1.0)"),
    ],
)
def test_each_kind_of_mistake_is_made(kind, line):
    assert (kind, line) in lines()


def test_annotations_messages_axes_and_text_are_left_alone():
    for _, line in lines():
        assert '"""' not in line
        assert "ValueError" not in line
        assert not line.startswith("def") or '"a - b"' in line
        assert not line.startswith("def") or '"c * d"' in line
        assert "axis=(1)" not in line


def test_every_mistake_is_python_on_one_line_that_means_something_else():
    for m in finder.Finder("f.py", SOURCE).mutants():
        changed = m.apply(SOURCE)
        old, new = SOURCE.splitlines(), changed.splitlines()
        assert [k + 1 for k in range(len(old)) if old[k] != new[k]] == [m.line]
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(SOURCE))


@pytest.mark.parametrize("area", areas.AREAS, ids=lambda area: area.name)
def test_every_area_names_sources_and_tests_that_exist(area):
    area.check_tests()
    assert area.files()


@pytest.mark.slow
def test_every_mistake_that_is_said_to_change_nothing_can_be_made_and_has_a_reason():
    for known in areas.EQUIVALENT:
        assert mutants.mistakes(known)
        assert len(known.reason) > 20


def test_every_mistake_that_was_once_let_pass_can_still_be_made():
    for drawn in mutants.named():
        drawn.area.check_tests()
        (mutant,) = drawn.tried
        ast.parse(mutant.apply(mutants.text(mutant.path)))


def test_a_source_or_a_test_that_has_gone_is_named():
    with pytest.raises(areas.GoneError, match="solve:NoSuchThing"):
        areas.defining("solve:NoSuchThing")
    with pytest.raises(areas.GoneError, match="no test tests"):
        replace(areas.AREAS[0], first=("tests/gone.py",)).check_tests()


@pytest.mark.slow
def test_the_same_seed_draws_the_same_mistakes_whatever_else_is_drawn_from():
    area = next(a for a in areas.AREAS if a.name == "outlier rejection")
    ten = mutants.draw(area, 10, 3)
    assert ten == mutants.draw(area, 10, 3)
    assert ten != mutants.draw(area, 10, 4)
    every = mutants.draw(area, 0, 3)
    assert len(every.tried) + len(every.equivalent) == every.possible
    assert set(ten.tried) <= set(every.tried)
    wider = replace(area, sources=(*area.sources, "fusion:align_robust"))
    assert set(mutants.draw(wider, 10, 3).tried) <= set(ten.tried) | set(mutants.draw(wider, 0, 3).tried)


def test_the_page_keeps_the_rows_of_areas_that_were_not_run():
    first, second = areas.AREAS[:2]
    page = "before\n" + "".join(mutants.TABLE) + "after\n"
    one = mutants.on_page([(second.name, "300", "16", "12", "75 %", "1")], page)
    both = mutants.on_page([(first.name, "100", "10", "10", "100 %", "0")], one)
    again = mutants.on_page([(second.name, "300", "16", "16", "100 %", "0")], both)
    assert both.startswith("before\n")
    assert both.endswith("after\n")
    assert both.index(first.name) < both.index(second.name)
    assert "| all | 400 | 26 | 22 | 85 % | 1 |" in both
    assert "| all | 400 | 26 | 26 | 100 % | 0 |" in again
    with pytest.raises(areas.GoneError):
        mutants.on_page([], "a page without a table")
