"""`decisions.toml`: given back as it is it changes nothing, an edited row changes just that, what cannot be is told."""

import json
import re

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import ReaderError, UsageError
from mapweave.io.decisions import decisions_of

from ..laser.team_logs import cut, office

pytestmark = pytest.mark.usefixtures("_remembered")


@pytest.fixture(scope="module")
def made(office_map):
    return office_map


def text(made):
    return (made[1] / "decisions.toml").read_text(encoding="utf-8")


def held(made):
    import tomllib

    return tomllib.loads(text(made))


def with_word(rows, decision, **fields):
    """The tables with another decision in the first row of these fields, and that row."""
    for row in rows:
        if all(row.get(name) == value for name, value in fields.items()):
            row["decision"] = decision
            return row
    raise AssertionError(fields)


def test_the_file_given_back_as_it_is_changes_no_byte(made, logs, tmp_path):
    mapweave.map(logs, tmp_path / "again", decisions=made[1] / "decisions.toml")
    names = sorted(p.relative_to(made[1]) for p in made[1].rglob("*") if p.is_file())
    assert "decisions.toml" in map(str, names)
    for name in names:
        one, other = ((folder / name).read_bytes() for folder in (made[1], tmp_path / "again"))
        if name.name == "metrics.json":
            one, other = ({**json.loads(b), "timing": 0} for b in (one, other))
        if name.name != "report.html":  # it tells how long a scan took
            assert one == other, name


@pytest.mark.slow
def test_two_robots_said_to_be_apart_stay_apart_and_what_scans_say_is_told(made, logs, tmp_path):
    """Given from the second robot's side; the file that is written tells it from the first's."""
    told = held(made)
    row = with_word(told["pairs"], "apart", a="1", b="2")
    row["a"], row["b"] = "2", "1"
    result = mapweave.map(logs, tmp_path / "apart", decisions=told)
    assert [c.robots for c in result.components] == [("1",), ("2",)]
    assert "merge-forbidden" in {f.code for f in result.findings}
    (merge,) = result.merges
    assert merge.reason.startswith("said to be apart; by their scans: merged on")
    again = mapweave.map(logs, tmp_path / "again", decisions=tmp_path / "apart" / "decisions.toml")
    assert [c.robots for c in again.components] == [("1",), ("2",)]
    assert (tmp_path / "again" / "decisions.toml").read_bytes() == (tmp_path / "apart" / "decisions.toml").read_bytes()


@pytest.mark.slow
def test_a_place_said_to_be_apart_leaves_the_graph_and_only_that(made, logs):
    told = held(made)
    row = with_word(told["places"], "apart", robot_a="1", robot_b="1", found="together")
    result = mapweave.map(logs[:1], decisions={"logs": {}, "places": [row]})
    before, after = (
        {(float(g.t[c.first]), float(g.t[c.second])): c.accepted for c in g.closures}
        for g in (made[0].maps[0].graph, result.maps[0].graph)
    )
    key = (row["stamp_a"], row["stamp_b"])
    assert before[key]
    assert not after[key]
    assert [k for k in before if before[k] != after[k]] == [key]
    moved = np.abs(result.maps[0].graph.pose - made[0].maps[0].graph.pose).max()
    assert 0.0 < moved < 0.2


def test_a_place_that_scans_refuse_is_honoured_and_told_to_contradict_them(made, logs):
    old = made[0].maps[0].graph

    def off(graph, c):
        return se2.between(c.measured, se2.between(graph.pose[c.first], graph.pose[c.second]))

    refused = [c for c in old.closures if not c.accepted and abs(off(old, c)[2]) < 0.3]
    wanted = max(refused, key=lambda c: np.hypot(*off(old, c)[:2]))
    first, second = float(old.t[wanted.first]), float(old.t[wanted.second])
    row = with_word(held(made)["places"], "together", robot_a="1", stamp_a=first, robot_b="1", stamp_b=second)
    result = mapweave.map(logs[:1], decisions={"places": [row]})
    graph = result.maps[0].graph
    (closure,) = [c for c in graph.closures if (c.first, c.second) == (wanted.first, wanted.second)]
    assert closure.accepted
    assert closure.reason == "said to be together"
    assert "decision-contradicted" in {f.code for f in result.findings}
    assert result.verdict == "doubtful"
    assert np.hypot(*off(graph, closure)[:2]) < 0.2 * np.hypot(*off(old, wanted)[:2])


@pytest.mark.slow
def test_two_robots_said_to_be_together_are_merged_where_it_is_said_and_told_if_scans_contradict(logs):
    world, _ = office(7)
    other = cut(world, 0, 60, "2")
    pose = [3.0, 1.0, 0.5]
    row = {"a": "1", "b": "2", "decision": "together", "pose": pose}
    free = mapweave.map([logs[0], other])
    assert len(free.components) == 2
    result = mapweave.map([logs[0], other], decisions={"pairs": [row]})
    assert [c.robots for c in result.components] == [("1", "2")]
    made = result.components[0]
    seen = se2.between(made.tracks["1"].pose[0], made.tracks["2"].pose[0])
    assert np.hypot(*se2.between(np.array(pose), seen)[:2]) < 0.8
    assert "merge-contradicted" in {f.code for f in result.findings}
    assert result.verdict == "doubtful"


@pytest.mark.slow
def test_a_pose_that_is_told_wins_over_that_of_the_scans(made, logs):
    told = list(made[0].merges[0].transform + np.array([3.0, 0.0, 0.0]))
    row = {"a": "1", "b": "2", "decision": "together", "pose": told}
    result = mapweave.map(logs, decisions={"pairs": [row]})
    assert np.hypot(*se2.between(np.array(told), result.merges[0].transform)[:2]) < 0.6
    assert "merge-contradicted" in {f.code for f in result.findings}


@pytest.mark.slow
def test_an_undecided_row_is_left_to_the_scans(made, logs):
    told = held(made)
    with_word(told["pairs"], "undecided", a="1", b="2")
    result = mapweave.map(logs, decisions=told)
    assert [c.robots for c in result.components] == [("1", "2")]


@pytest.mark.slow
def test_results_are_fused_as_it_is_said(made, logs, tmp_path):
    for k, log in enumerate(logs, 1):
        mapweave.map([log], tmp_path / f"r{k}")
    row = {"a": "r1/robot1", "b": "r2/robot1", "decision": "apart"}
    fused = mapweave.fuse([tmp_path / "r1", tmp_path / "r2"], decisions={"pairs": [row]})
    assert len(fused.components) == 2


@pytest.mark.slow
def test_results_of_unequal_cells_are_fused_in_the_finest_whichever_comes_first(logs):
    coarse, fine = (mapweave.map([log], resolution=cell) for log, cell in zip(logs, (0.2, 0.05), strict=True))
    for pair in ([coarse, fine], [fine, coarse]):
        (whole,) = mapweave.fuse(pair).components
        assert whole.grid.resolution == 0.05


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({"others": {}}, "unknown table 'others'"),
        ({"logs": {"1": 3}}, "logs: expected a text a robot"),
        ({"pairs": {}}, r"pairs: expected [[pairs]]"),
        ({"pairs": [{"a": "1"}]}, "pairs 1: no b; pairs 1: no decision"),
        ({"pairs": [{"a": "1", "b": "1", "decision": "apart"}]}, "robot 1 beside itself"),
        ({"pairs": [{"a": "1", "b": "2", "decision": "maybe"}]}, "expected one of together, apart, undecided"),
        ({"pairs": [{"a": "1", "b": "2", "decision": "apart", "why": ""}]}, "unknown key 'why'"),
        ({"pairs": [{"a": "1", "b": "2", "decision": "apart", "pose": [1, 2]}]}, "pose: expected x, y, theta"),
        ({"pairs": [{"a": "1", "b": "2", "decision": "apart", "pose": [1, 2, float("nan")]}]}, "pose: expected x, y"),
        ({"pairs": [{"a": "1", "b": "2", "decision": "apart", "pose": [0, 1e300, 0]}]}, "pose: expected x, y"),
        (
            {"pairs": [{"a": "1", "b": "2", "decision": "apart"}, {"a": "2", "b": "1", "decision": "together"}]},
            "two decisions on one pair: apart and together",
        ),
        (
            {"places": [{"robot_a": "1", "stamp_a": "x", "robot_b": "1", "stamp_b": 2, "decision": "apart"}]},
            "stamp_a: expected a stamp in seconds, found 'x'",
        ),
        (
            {"places": [{"robot_a": "1", "stamp_a": 1, "robot_b": "1", "stamp_b": 2, "decision": "together"}]},
            "a place at 2.0 s that is added: expected a pose",
        ),
        ({"masks": [{"robot": "1", "box": [1, 2, 3], "cells": "free"}]}, "box: expected x0, y0, x1, y1"),
        ({"masks": [{"robot": "1", "box": [1, 2, 3, 4], "cells": "gone"}]}, "cells: expected one of free, unknown"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_all_at_once(table, why):
    with pytest.raises(ReaderError, match=re.escape(why)):
        decisions_of(table)


def test_a_file_of_another_result_and_rows_of_nobody_are_refused(made, logs, tmp_path):
    told = held(made)
    told["logs"]["1"] = "0" * 64
    with pytest.raises(ReaderError, match="it is of another result: the scans of robot 1 are not those of"):
        mapweave.map(logs, decisions=told)
    row = {"robot_a": "1", "stamp_a": 1.25e9, "robot_b": "1", "stamp_b": 1017.0, "decision": "apart"}
    with pytest.raises(ReaderError, match=r"robot 1 has no keyframe at 1250000000\.0 s"):
        mapweave.map(logs[:1], decisions={"places": [row]})
    with pytest.raises(ReaderError, match="there is no robot 9 among 1"):
        mapweave.map(logs[:1], decisions={"pairs": [{"a": "1", "b": "9", "decision": "apart"}]})
    t = float(made[0].maps[0].graph.t[5])
    row = {"robot_a": "1", "stamp_a": t, "robot_b": "1", "stamp_b": t, "decision": "together", "pose": [0, 0, 0]}
    with pytest.raises(ReaderError, match="of robot 1 beside itself"):
        mapweave.map(logs[:1], decisions={"places": [row]})
    with pytest.raises(ReaderError, match="lies outside the map of robot 1"):
        mapweave.map(logs[:1], decisions={"masks": [{"robot": "1", "box": [500, 0, 501, 1], "cells": "free"}]})
    (tmp_path / "bad.toml").write_text("[[pairs", encoding="utf-8")
    (tmp_path / "log.clf").write_text("FLASER", encoding="utf-8")
    with pytest.raises(ReaderError, match="expected TOML"):  # before any log is read
        mapweave.map(tmp_path / "log.clf", decisions=tmp_path / "bad.toml")
    with pytest.raises(ReaderError, match="expected a file of decisions: No such file"):
        mapweave.map(logs, decisions=tmp_path / "none.toml")


def test_decisions_are_of_laser_logs_alone(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    with pytest.raises(UsageError, match="--decisions: only for laser logs"):
        mapweave.map(tmp_path / "team", decisions={"pairs": []})
