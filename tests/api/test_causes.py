"""`doctor` of a map names what bends it: planted causes, each by its own sign, and nothing of a map that is right."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from doctor import PLANTS, planted

import mapweave
from mapweave.api import causes
from mapweave.api.causes import MENDS, TOLD, WEAK, _ordered
from mapweave.api.read import Log
from mapweave.cli import _run
from mapweave.core.findings import KINDS, Finding


def named(cause, seed=3):
    found = mapweave.doctor(Log((Path("planted"),), tuple(log.finish() for log in planted(cause, seed, 1))))
    return [cause.name for cause in found.causes]


def test_a_map_that_is_right_has_no_cause():
    assert named("none") == []


@pytest.mark.parametrize("cause", ["symmetry", "corridor", "mirrored"])
def test_a_planted_cause_is_named_first(cause):
    assert named(cause)[0] == cause


@pytest.mark.slow
@pytest.mark.parametrize("cause", sorted(PLANTS.keys() - {"none", "symmetry", "corridor", "mirrored"}))
def test_every_planted_cause_is_named_first(cause):
    assert named(cause)[0] == cause


def test_a_log_that_is_refused_for_its_unit_has_a_cause_and_no_map():
    error = mapweave.DataError("a.log: the ranges are in centimetres: expected metres")
    found = causes.refused("a.log", error)
    assert (found.verdict, [c.name for c in found.causes]) == (None, ["units"])
    with pytest.raises(mapweave.DataError, match="no scan"):
        causes.refused("a.log", mapweave.DataError("a.log: no scan"))
    with pytest.raises(mapweave.ReaderError):
        mapweave.doctor("nowhere.mcap")


def test_every_code_is_of_a_finding_and_every_cause_has_words():
    assert not (TOLD.keys() | WEAK.keys()) - KINDS.keys()
    assert set(TOLD.values()) | set(WEAK.values()) <= MENDS.keys()
    assert set(PLANTS) - {"none"} <= MENDS.keys()


def test_what_lies_deepest_comes_first_and_what_may_be_its_sign_counts_alone():
    def of(*findings):
        return [c.name for c in _ordered(SimpleNamespace(maps=(), findings=findings))]

    gap, mirrored = Finding("scan-gap", "1", (1.0, 9.0), 8.0), Finding("beams-mirrored", "1")
    through = Finding("walls-seen-through", "1", None, 30.0)
    assert of(gap, through, mirrored) == ["mirrored", "gaps"]
    assert of(through) == ["symmetry"]
    assert of() == []


@pytest.mark.parametrize(
    ("told", "cause"),
    [
        ({"ways": 10.0, "turns": 60.0, "aside": 1.0}, "lag"),
        ({"ways": 40.0, "turns": 0.0, "aside": -88.0}, "mounting"),
        ({"ways": 40.0, "turns": 0.0, "aside": 0.5}, "slip"),
        ({"ways": 40.0, "turns": 60.0, "aside": 0.5}, "mixed"),
    ],
)
def test_wheels_that_tell_another_motion_are_told_apart_by_what_of_it_is_another(told, cause):
    log = mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=2.0), seed=1).log
    made = mapweave.map(log)
    found = (Finding("wheels-other", made.maps[0].robot, value=told),)
    assert cause in [name for name, _ in causes._measured(made.maps[0], found)]


def test_the_command_tells_a_sentence_with_evidence_and_mending(tmp_path, capsys):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=12, minutes=1.0, seed=8)
    mapweave.map(tmp_path / "team", tmp_path / "out")
    assert _run(["doctor", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out == "nothing that was looked for bends this map\n"
    assert _run(["doctor", str(tmp_path / "team"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["causes"] == []
    told = causes.Causes("x", "bad", (causes.Cause("mirrored", "2", "the scans turn against the odometry"),))
    assert told.summary() == (
        "likeliest cause: robot2: the scanner's beams run the wrong way round (the scans turn against the odometry); "
        "map again with --mirrored"
    )


def test_a_result_that_is_no_map_is_refused_as_one(tmp_path):
    """It was taken for a folder of logs, whose files were missing."""
    sightings = {"observer": ["a", "b", "c"], "target": ["b", "c", "a"], "bearing": [0.0, 2.1, -2.1]}
    mapweave.locate(sightings, tmp_path / "located", anchors={"a": [0.0, 0.0], "b": [1.0, 0.0]})
    with pytest.raises(mapweave.UsageError, match=r"located: expected a map or logs, .* another kind \(Located\)"):
        mapweave.doctor(tmp_path / "located")


def test_what_makes_a_map_doubtful_and_is_a_sign_of_no_cause_is_told_in_its_own_words(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=1, landmarks=8, minutes=0.5, seed=8)
    loose, untold = Finding("way-loose", "1", value=3.0), Finding("no-wheels", "1")
    told = mapweave.doctor(replace(mapweave.map(tmp_path / "team"), findings=(loose, untold)))
    assert (told.causes, told.doubts) == ((), (loose,))
    (line,) = told.lines()
    assert line.startswith("doubtful: robot 1: where it was then is known to 3.0 m")
    assert line.endswith("record odometry.")
    assert [row["code"] for row in told.metrics["doubts"]] == ["way-loose"]
