"""What would give a wrong impression in silence is told: nothing to score, another frame, options without effect."""

import json
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.io.laser_logs import read_laser
from mapweave.io.mcap import write_mcap
from mapweave.io.tum import read_tum, write_tum


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    home = tmp_path_factory.mktemp("trust")
    mapweave.simulate_landmarks(home / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(home / "team", home / "out")
    (home / "elsewhere.csv").write_text("id,x,y\n901,1.0,2.0\n902,2.0,2.0\n", encoding="utf-8")
    (home / "robot1.tum").write_text("5.0 0 0 0 0 0 0 1\n6.0 1 0 0 0 0 0 1\n", encoding="utf-8")
    (home / "late.relations").write_text("5.0 6.0 1.0 0.0 0.0 0.0 0.0 0.0\n", encoding="utf-8")
    mapweave.simulate_laser(home / "drive.mcap", mapweave.CorridorConfig(distance=12.0), seed=1)
    return home


@pytest.mark.parametrize(
    ("truth", "why"),
    [
        ("elsewhere.csv", "no landmark of the result is surveyed"),
        ("robot1.tum", "the true poses of robot1 are of other times"),
        ("late.relations", "none of 1 relations has a pose"),
    ],
)
def test_a_truth_that_scores_nothing_ends_with_1_the_reason_and_the_rule(home, capsys, truth, why):
    assert _run(["evaluate", str(home / "out"), "--truth", str(home / truth)]) == 1
    err = capsys.readouterr().err
    assert f"{truth}: nothing to score: {why}" in err
    assert "the name holds robotK" in err
    assert err.count("\n") == 1


def test_a_map_whose_truth_scores_nothing_is_kept_and_says_so(home, tmp_path, capsys):
    words = ["map", str(home / "team"), "--out", str(tmp_path / "out"), "--truth", str(home / "elsewhere.csv")]
    assert _run(words) == 0
    assert "warning: the truth: nothing to score: no landmark" in capsys.readouterr().out
    told = json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert any("nothing to score" in text for text in told["warnings"])


def test_options_without_effect_on_laser_logs_are_told_on_the_terminal_and_in_the_metrics(home, capsys):
    words = ["--weights", "full", "--no-refine", "--method", "gated", "--truth", str(home / "robot1.tum")]
    assert _run(["map", str(home / "drive.mcap"), "--out", str(home / "laser"), *words]) == 0
    out = capsys.readouterr().out
    told = json.loads((home / "laser" / "metrics.json").read_text(encoding="utf-8"))
    for option in ("--weights", "--no-refine"):
        line = f"{option} has no effect"
        assert line in out
        assert any(text.startswith(line) for text in told["robots"]["1"]["warnings"])
    assert any("the truth: nothing to score" in text for text in told["warnings"])


def test_options_without_effect_on_a_swarm_are_told(tmp_path, capsys):
    still, moving = tmp_path / "still.csv", tmp_path / "moving.csv"
    mapweave.simulate_swarm(still, mapweave.SwarmScene(robots=9), seed=1)
    assert _run(["locate", str(still), "--out", str(tmp_path / "a"), "--filtered"]) == 0
    assert "warning: --filtered has no effect: the robots stand still" in capsys.readouterr().out
    made = mapweave.simulate_swarm(moving, mapweave.SwarmScene(robots=9, steps=4), seed=2)
    known = {made.table.ids[c]: made.position[0, c] for c in made.corners}
    found = mapweave.locate(moving, anchors=known, initial=tmp_path / "still.truth.csv")
    assert "--initial has no effect: the robots move" in found.metrics["warnings"]
    assert not any("no effect" in text for text in mapweave.locate(moving, anchors=known).metrics["warnings"])


def test_a_truth_in_another_frame_than_the_map_is_told_with_the_motion_between(home, tmp_path):
    if not (home / "laser").exists():
        mapweave.map(home / "drive.mcap", home / "laser", method="gated")
    estimate = read_tum(home / "laser" / "trajectories" / "robot1.tum")
    T = np.array([3.0, -2.0, 0.5])
    files = {"same": estimate, "moved": Track(estimate.t, se2.compose(T, estimate.pose))}
    files["late"] = Track(estimate.t + 1e6, estimate.pose)
    said = {}
    for name, track in files.items():
        write_tum(tmp_path / f"{name}.tum", track)
        found = mapweave.localize(
            home / "drive.mcap", home / "laser", start=(0.0, 0.0, 0.0), truth=tmp_path / f"{name}.tum"
        )
        said[name] = found.doubts()
        if name == "moved":
            assert np.allclose(se2.compose(np.array(found.score.offset), T), 0.0, atol=0.15)
            assert found.metrics["evaluation"]["aligned_median"] < 0.2
            assert said[name][0] in found.summary()
    assert said["same"] == []
    assert "it is in another frame than the map" in said["moved"][0]
    assert "no pose of the truth lies between" in said["late"][0]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ([], ("Make one map of the logs", "Find every robot of a swarm", "Check the installation")),
        (["simulate"], ("A team with cameras", "A swarm of camera robots", "A laser drive through an office")),
        (["reproduce"], ("Kojima, Okawa, Namerikawa", "Hamatani, Nakamura", "Hara, Kawata", "Yuan, Huang")),
    ],
)
def test_help_says_in_a_line_what_each_command_does(command, words, capsys):
    assert _run([*command, "--help"]) == 0
    out = capsys.readouterr().out
    for word in words:
        assert word in out


def test_a_strict_map_ends_with_1_unless_its_verdict_is_good_and_is_written_all_the_same(home, tmp_path, capsys):
    logs = [str(home / "drive.mcap")]
    few = read_laser(home / "drive.mcap")
    write_mcap(tmp_path / "few.mcap", replace(few, scan_t=few.scan_t[:3], scans=few.scans[:3]))
    for log, code, made in ((logs[0], 0, "good"), (str(tmp_path / "few.mcap"), 1, "doubtful")):
        out = tmp_path / made
        assert _run(["map", log, "--out", str(out), "--strict"]) == code
        said = capsys.readouterr()
        assert f"\nverdict: {made}" in said.out
        assert said.out.splitlines()[-1].startswith("report: ")
        told = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
        assert told["verdict"] == told["robots"]["1"]["verdict"] == made
        assert (f"Verdict: {made}" in (out / "report.html").read_text(encoding="utf-8")) == (code in {0, 1})
        assert ("few-scans" in [f["code"] for f in told["findings"]]) == (code == 1)
        assert said.err.endswith("verdict: doubtful: few-scans (robot 1)\n") == (code == 1)
    with pytest.raises(mapweave.VerdictError, match="doubtful: few-scans") as end:
        mapweave.map(tmp_path / "few.mcap", strict=True)
    assert end.value.result.verdict == "doubtful"
    assert [f.code for f in end.value.result.findings if f.severity != "note"] == ["few-scans"]


def test_landmark_maps_have_a_verdict_and_findings_too(home):
    told = json.loads((home / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert told["verdict"] == "good"
    assert {robot["verdict"] for robot in told["robots"].values()} == {"good"}
    assert [f["text"] for f in told["findings"] if f["robot"] is None] == told["warnings"]
