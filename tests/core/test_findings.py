"""Findings are values with a code: their words, their verdict and their page of the documentation are one table's."""

import ast
import json
import pickle
import string
from dataclasses import replace
from pathlib import Path

import pytest

import mapweave
from mapweave.core.findings import (
    KINDS,
    Finding,
    Unused,
    finding_of,
    of_robot,
    shortly,
    table_page,
    unused_of,
    verdict,
    verdict_line,
)

HOUSE = Path(mapweave.__file__).parent


def value_of(code):
    """A value that the code's text can be made of."""
    names = {name for _, name, _, _ in string.Formatter().parse(KINDS[code].text) if name}
    spec = {name: spec for _, name, spec, _ in string.Formatter().parse(KINDS[code].text) if name}
    values = {name: 3.0 if spec[name] else "some" for name in names}
    return values.get("value") if names <= {"value"} else values


def codes_made(source):
    """The codes that calls of `Finding` and `find` name in a module."""
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call) and n.args]
    named = [c for c in calls if getattr(c.func, "id", getattr(c.func, "attr", "")) in {"Finding", "find"}]
    return {c.args[0].value for c in named if isinstance(c.args[0], ast.Constant) and isinstance(c.args[0].value, str)}


@pytest.mark.parametrize("code", sorted(KINDS))
def test_every_code_has_a_sentence_a_meaning_and_a_row_that_gives_it_back(code):
    found = Finding(code, "robot2", (1.0, 4.5), value_of(code), "nothing was done")
    assert found.text.startswith("from 1.0 s to 4.5 s: ")
    assert found.text.endswith("; nothing was done")
    assert found.told == f"robot 2: {found.text}"
    assert KINDS[code].means.endswith(".")
    assert KINDS[code].do.endswith(".")
    row = json.loads(json.dumps(found.row()))
    assert list(row) == ["code", "robot", "from", "to", "value", "action", "text"]
    assert finding_of(row) == found
    assert pickle.loads(pickle.dumps(found)) == found  # noqa: S301  (our own)


def test_every_code_of_the_table_is_made_somewhere_and_no_other():
    made = set()
    for path in HOUSE.rglob("*.py"):
        made |= codes_made(path.read_text(encoding="utf-8"))
    assert made - set(KINDS) == set()
    assert set(KINDS) - made == set()


def test_codes_that_a_module_makes_are_found():
    assert codes_made("f.find('a', 1)\nFinding('b')\nstr.find(x, 'c')\nFinding(code)") == {"a", "b"}


@pytest.mark.parametrize(
    ("severities", "expected"),
    [((), "good"), (("note",), "good"), (("note", "doubtful"), "doubtful"), (("bad", "doubtful", "note"), "bad")],
)
def test_the_gravest_finding_makes_the_verdict(severities, expected):
    one = {kind.severity: code for code, kind in KINDS.items()}
    found = [Finding(one[s], value=value_of(one[s])) for s in severities]
    assert verdict(found) == verdict(found[::-1]) == expected


def test_the_verdict_line_names_what_made_it_and_of_whom_each_once():
    found = [
        Finding("beams-mirrored", "robot1"),
        Finding("segment-apart", "3", value=7),
        Finding("segment-apart", "1", value=7),
        Finding("segment-apart", "1", value=8),
        Finding("robots-apart", value="robot2"),
        Finding("stamps-none", "1", value=1.0),
    ]
    assert verdict_line(found) == "verdict: bad: beams-mirrored (robot 1); segment-apart (robot 3, 1); robots-apart"
    assert verdict_line(found[-1:]) == "verdict: good"


def test_a_moment_is_told_as_one_and_a_log_may_be_renamed():
    found = Finding("scan-gap", "1", (3.0, 3.0), 62.0)
    assert found.text == "at 3.0 s: no scans for 62.0 s while the robot drove"
    assert [f.robot for f in of_robot([found, Finding("saw-nothing")], "first/robot1")] == ["first/robot1"] * 2


@pytest.mark.parametrize(
    "row",
    [
        None,
        {},
        {"code": "of another version"},
        {"code": "scan-gap", "value": "long"},
        {"code": "stamp-lag", "value": 1.0},
    ],
)
def test_a_row_that_is_no_finding_is_refused(row):
    with pytest.raises(ValueError, match="expected"):
        finding_of(row)


def test_what_was_not_used_comes_back_from_its_row():
    left = Unused("drive.mcap", "/ground_truth", "geometry_msgs/msg/PoseStamped", 370, "no reader for this type")
    assert unused_of(left.row()) == left


@pytest.mark.parametrize("wrong", [None, {}, {"messages": -1}, {"messages": True}, {"messages": "many"}, {"more": 1}])
def test_a_row_that_is_nothing_unused_is_refused(wrong):
    row = Unused("drive.mcap", "/tf", "tf2_msgs/msg/TFMessage", 3, "no reader for this type").row()
    with pytest.raises(ValueError, match="expected"):
        unused_of({**row, **wrong} if wrong else wrong)


def test_a_code_that_is_not_in_the_table_cannot_be_made():
    with pytest.raises(ValueError, match="no finding is called 'other'"):
        Finding("other")


def test_the_page_of_the_documentation_is_the_table():
    page = HOUSE.parent.parent / "docs" / "findings.md"
    assert page.read_text(encoding="utf-8") == table_page(), "python -m mapweave.core.findings > docs/findings.md"


def test_of_many_findings_of_a_kind_people_read_a_few_and_how_many_more_there_are():
    cuts = [Finding("track-cut", "1", (float(k), k + 1.0), "few returns match") for k in range(60)]
    other = Finding("light-unused", "1", value="the log has none")
    lines = shortly([*cuts[:30], other, *cuts[30:]], named=True)
    assert lines == [*(f.told for f in cuts[:3]), "robot 1: 57 more of track-cut: metrics.json has all", other.told]
    assert shortly(cuts[:4]) == [f.text for f in cuts[:4]]
    two = [*cuts[:5], *(replace(f, robot="2") for f in cuts[:2])]
    assert len(shortly(two)) == 4 + 2
