"""The mutation run makes the mistakes that it names, each on one line, and knows where sources and tests live."""

import ast
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parent.parent
SPEC = spec_from_file_location("mutants", TOP / "benchmarks" / "mutants.py")
mutants = module_from_spec(SPEC)
SPEC.loader.exec_module(mutants)

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
    found = mutants.Finder("f.py", SOURCE).mutants()
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
    for m in mutants.Finder("f.py", SOURCE).mutants():
        changed = m.apply(SOURCE)
        old, new = SOURCE.splitlines(), changed.splitlines()
        assert [k + 1 for k in range(len(old)) if old[k] != new[k]] == [m.line]
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(SOURCE))


def test_every_area_names_sources_and_tests_that_exist():
    for area in mutants.AREAS:
        for pattern in area.sources:
            assert list((TOP / "src" / "mapweave").glob(pattern)), pattern
        for test in area.tests:
            assert (TOP / test).exists(), test


def test_the_same_pattern_names_the_same_mistakes_and_no_other_file():
    drawn = mutants.all_mutants("solve/problem.py")
    assert drawn == mutants.all_mutants("solve/problem.py")
    assert {m.path for m, _ in drawn} == {"solve/problem.py"}
    assert len(drawn) > 10
