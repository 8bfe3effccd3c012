"""The landmark job as a user sees it, through the installed command line alone: no data, nothing from other tests."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mapweave.api.result import load

from .terminal import run


def tree(folder: Path, *patterns: str):
    found = {p for pattern in patterns for p in folder.glob(pattern) if p.is_file()}
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(found)}


RESULT = ("landmarks.*", "trajectories/*", "local/*/*")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A small recording and its map with truth, made through the command line."""
    home = tmp_path_factory.mktemp("job")
    words = ("--robots", 3, "--landmarks", 12, "--minutes", 1, "--misreads", 0.03, "--seed", 5)
    code, out, err = run("simulate", "landmarks", "--out", home / "team", *words)
    assert (code, err) == (0, "")
    assert "3 robots, 12 landmarks" in out
    code, out, err = run("map", home / "team", "--out", home / "a", "--truth", home / "team", "--seed", 3)
    assert (code, err) == (0, "")
    return home


@pytest.mark.drawn
def test_map_writes_the_documented_files(world):
    made = {str(p.relative_to(world / "a")) for p in (world / "a").rglob("*") if p.is_file()}
    robots = [f"trajectories/robot{k}.{end}" for k in (1, 2, 3) for end in ("tum", "cov.csv")]
    figures = {"figures/fused_map.png", "figures/landmark_errors.png"}
    assert {"metrics.json", "landmarks.csv", "landmarks.npz", "report.html", *robots, *figures} <= made
    assert all((world / "a" / "local" / f"robot{k}").is_dir() for k in (1, 2, 3))


def test_metrics_hold_the_documented_keys(world):
    metrics = json.loads((world / "a" / "metrics.json").read_text())
    assert {"version", "seed", "robots", "components", "fusion", "timing", "evaluation"} <= set(metrics)
    assert metrics["seed"] == 3
    assert metrics["components"] == [["1", "2", "3"]]
    keys = {"source", "odometry", "sightings", "dropped", "down_weighted", "nis_median", "warnings", "verdict"}
    assert all(keys <= set(metrics["robots"][k]) for k in ("1", "2", "3"))
    keys = {"robot", "shared", "decision", "reason", "scale", "variance_factor"}
    assert all(keys <= set(row) for row in metrics["fusion"])
    assert [row["decision"] for row in metrics["fusion"]] == ["reference", "merged", "merged"]


def test_landmarks_stand_in_a_table_and_in_arrays_with_the_joint_covariance(world):
    with (world / "a" / "landmarks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["id", "x", "y", "var_x", "cov_xy", "var_y", "robots", "sightings"]
    with np.load(world / "a" / "landmarks.npz", allow_pickle=False) as held:
        ids, mean, cov = held["ids"], held["mean"], held["cov"]
    assert [row["id"] for row in rows] == list(ids)
    assert mean.shape == (len(ids), 2)
    assert cov.shape == (2 * len(ids), 2 * len(ids))
    assert np.linalg.eigvalsh(cov).min() > 0
    assert abs(float(rows[0]["x"]) - mean[0, 0]) < 1e-8
    assert set(";".join(row["robots"] for row in rows).split(";")) <= {"1", "2", "3"}


@pytest.mark.parametrize("robot", ["robot1", "robot2", "robot3"])
def test_trajectories_have_one_pose_at_every_odometry_and_sighting_stamp(world, robot):
    """At stamps of misread barcodes too, which no estimate is made from."""
    stamps = set()
    for name in (f"{robot.title()}_Odometry.dat", f"{robot.title()}_Measurement.dat"):
        lines = (world / "team" / name).read_text().splitlines()
        stamps |= {line.split()[0] for line in lines if not line.startswith("#")}
    assert json.loads((world / "a" / "metrics.json").read_text())["robots"][robot[-1]]["dropped"]["misread barcode"]
    lines = (world / "a" / "trajectories" / f"{robot}.tum").read_text().splitlines()
    assert [f"{float(line.split()[0]):.3f}" for line in lines] == sorted(stamps)
    assert all(len(line.split()) == 8 for line in lines)
    covariances = (world / "a" / "trajectories" / f"{robot}.cov.csv").read_text().splitlines()
    assert covariances[0] == "t,xx,xy,yy,xt,yt,tt"
    assert len(covariances) == len(lines) + 1


def test_the_map_frame_is_the_first_pose_of_the_lowest_robot(world):
    first = (world / "a" / "trajectories" / "robot1.tum").read_text().splitlines()[0].split()
    assert [float(v) for v in first[1:]] == [0, 0, 0, 0, 0, 0, 1]


@pytest.fixture
def made(world, tmp_path):
    """The map again, for `evaluate` to add scores to."""
    return Path(shutil.copytree(world / "a", tmp_path / "a"))


def test_evaluate_prints_the_documented_keys(world, made):
    written = json.loads((made / "metrics.json").read_text())["evaluation"]
    code, out, err = run("evaluate", made, "--truth", world / "team", "--json")
    assert (code, err) == (0, "")
    told = json.loads(out)
    keys = {
        *("landmark_rmse", "landmark_n", "nees_per_dof", "dof", "alignment", "mean_single_rmse", "naive_rmse"),
        *("exchanged", "landmark_rmse_exchanged", "nees_per_dof_exchanged", "robots"),
    }
    assert keys <= set(told)
    assert told["dof"] == 2 * told["landmark_n"] - 3
    assert len(told["alignment"]) == 3
    assert {"ate", "n", "truth", "single_map_rmse"} <= set(told["robots"]["1"])
    assert told["robots"]["1"]["truth"] == "Groundtruth"
    assert {k: v for k, v in told.items() if k not in ("robots", "mean_ate")} == {
        k: v for k, v in written.items() if k not in ("robots", "mean_ate")
    }
    assert told["robots"]["1"]["ate"] == pytest.approx(written["robots"]["1"]["ate"], rel=1e-5)
    code, out, _ = run("evaluate", made, "--truth", world / "team")
    assert code == 0
    assert "landmarks: RMSE" in out


def test_a_landmark_survey_and_tum_files_are_truth_too(world, made):
    survey = world / "survey.csv"
    rows = [line.split() for line in (world / "team" / "Landmark_Groundtruth.dat").read_text().splitlines()[1:]]
    survey.write_text("id,x,y\n" + "".join(f"{r[0]},{r[1]},{r[2]}\n" for r in rows))
    whole = json.loads(run("evaluate", made, "--truth", world / "team", "--json")[1])
    told = json.loads(run("evaluate", made, "--truth", survey, "--json")[1])
    assert told["landmark_rmse"] == pytest.approx(whole["landmark_rmse"], rel=1e-6)
    own = [made / "trajectories" / f"robot{k}.tum" for k in (1, 2)]
    told = json.loads(run("evaluate", made, "--truth", *own, "--json")[1])
    assert told["robots"]["1"]["ate"] < 1e-9
    assert told["robots"]["2"]["truth"] == "TUM"


@pytest.mark.slow
def test_equal_runs_differ_in_timing_alone_whoever_does_the_work(world):
    run("map", world / "team", "--out", world / "b", "--truth", world / "team", "--seed", 3, "--jobs", 2)
    one, two = (json.loads((world / d / "metrics.json").read_text()) for d in "ab")
    one.pop("timing")
    two.pop("timing")
    assert one == two
    assert tree(world / "a", *RESULT) == tree(world / "b", *RESULT)


def test_without_truth_the_map_is_the_same_to_the_byte(world):
    bare = world / "bare" / "team"
    bare.parent.mkdir()
    shutil.copytree(world / "team", bare, ignore=shutil.ignore_patterns("*Groundtruth*"))
    code, _, err = run("map", bare, "--out", world / "c", "--seed", 3)
    assert (code, err) == (0, "")
    wanted = ("landmarks.*", "trajectories/*")
    assert tree(world / "a", *wanted) == tree(world / "c", *wanted)


@pytest.mark.slow
def test_a_zip_is_read_as_its_folder(world):
    archive = shutil.make_archive(str(world / "team"), "zip", world, "team")
    code, _, err = run("map", archive, "--out", world / "z", "--seed", 3)
    assert (code, err) == (0, "")
    assert tree(world / "a", "landmarks.*") == tree(world / "z", "landmarks.*")


@pytest.mark.slow
@pytest.mark.drawn
def test_fusing_saved_maps_names_robots_after_their_folders(world):
    run("map", world / "team", "--out", world / "one", "--robots", "1,2")
    run("map", world / "team", "--out", world / "two", "--robots", "3")
    code, _, err = run("fuse", world / "one", world / "two", "--out", world / "f")
    assert (code, err) == (0, "")
    metrics = json.loads((world / "f" / "metrics.json").read_text())
    assert set(metrics["robots"]) == {"one/robot1", "one/robot2", "two/robot3"}
    assert (world / "f" / "trajectories" / "two" / "robot3.tum").exists()
    code, out, _ = run("evaluate", world / "f", "--truth", world / "team", "--json")
    assert code == 0
    assert json.loads(out)["robots"]["two/robot3"]["ate"] < 1.5


@pytest.mark.slow
def test_the_same_log_twice_counts_once(world):
    run("map", world / "team", "--out", world / "again", "--robots", "1")
    run("map", world / "team", "--out", world / "also", "--robots", "1")
    code, _, _ = run("fuse", world / "again", world / "also", "--out", world / "g")
    metrics = json.loads((world / "g" / "metrics.json").read_text())
    assert code == 0
    assert any("counted once" in w for w in metrics["warnings"])
    assert (world / "g" / "landmarks.csv").exists()


def test_no_refine_is_accepted(world):
    assert run("map", world / "team", "--out", world / "n", "--robots", "1", "--no-refine")[0] == 0


def test_smoothed_while_the_logs_play_the_result_is_written_and_read_back(world):
    code, _, err = run("map", world / "team", "--out", world / "live", "--online")
    assert (code, err) == (0, "")
    metrics = json.loads((world / "live" / "metrics.json").read_text())
    assert metrics["online_smoothing"]["steps"] > 0
    assert "smoothed-late" not in {f["code"] for f in metrics["findings"]}
    assert load(world / "live").run.members


def test_a_robot_named_twice_is_one(world):
    code, _, err = run("map", world / "team", "--out", world / "twice", "--robots", "1,1", "--no-refine")
    assert (code, err) == (0, "")
    assert set(json.loads((world / "twice" / "metrics.json").read_text())["robots"]) == {"1"}


def test_view_tells_where_the_report_is_when_there_is_no_display(world, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    code, out, _ = run("view", world / "a")
    assert code == 0
    assert str(world / "a" / "report.html") in out


@pytest.mark.slow
@pytest.mark.drawn
def test_fused_while_the_logs_play_the_last_map_is_the_offline_one(world):
    code, _, err = run("map", world / "team", "--out", world / "on", "--seed", 3, "--fuse-every", 20)
    assert (code, err) == (0, "")
    assert tree(world / "a", *RESULT) == tree(world / "on", *RESULT)
    online = json.loads((world / "on" / "metrics.json").read_text())["online"]
    assert [round(p["t"]) for p in online] == [20, 40, 60]
    assert online[-1]["robots"] == 3
    assert online[-1]["log_det"] < online[0]["log_det"] or online[-1]["landmarks"] > online[0]["landmarks"]
    assert (world / "on" / "figures" / "growth.png").exists()
