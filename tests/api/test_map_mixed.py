"""`map` of mixed teams: files in, one frame out, scored by `evaluate`; what cannot be is said."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import DataError, MapweaveError, ReaderError, UsageError
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.laser_map import read_grid
from mapweave.io.mcap import write_mcap
from mapweave.io.mixed_logs import is_mixed, sorted_logs


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    home = tmp_path_factory.mktemp("mixed") / "team"
    mapweave.simulate_team(home, lasers=1, cameras=2, bearings=0, landmarks=8, minutes=2.0, seed=4)
    return home


@pytest.fixture(scope="module")
def made(team, tmp_path_factory):
    out = tmp_path_factory.mktemp("mixed") / "out"
    return mapweave.map(team, out, truth=team), out


def test_walls_landmarks_and_ways_are_written_in_one_frame(made):
    result, out = made
    assert {p.name for p in out.iterdir()} == {
        *("landmarks.csv", "landmarks.npz", "trajectories", "local", "calibration.json", "metrics.json"),
        *("map.pgm", "map.yaml", "grid.npz", "report.html", "result.npz", "figures"),
    }
    assert result.maps[0].robots == ("robot1", "robot2", "robot3")
    grid = read_grid(out / "grid.npz")[0]
    x0, x1, y0, y1 = grid.extent
    for track in result.maps[0].tracks.values():
        assert (track.pose[:, 0] > x0).all()
        assert (track.pose[:, 0] < x1).all()
        assert (track.pose[:, 1] > y0).all()
        assert (track.pose[:, 1] < y1).all()
    np.testing.assert_allclose(result.maps[0].tracks["robot1"].pose[0], 0.0, atol=1e-12)
    told = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    assert told["components"] == [["1", "2", "3"]]
    assert told["ties"][0]["agree"] >= 4
    assert told["evaluation"]["landmark_rmse"] < 0.25


def test_evaluate_gives_the_same_score_afterwards(made, team):
    result, out = made
    again = mapweave.evaluate(out, team).as_json()
    assert again["landmark_rmse"] == pytest.approx(result.evaluation.as_json()["landmark_rmse"], abs=1e-6)
    assert again["robots"]["1"]["ate"] < 0.2


def test_what_a_robot_carries_is_told(made):
    result, out = made
    told = json.loads((out / "metrics.json").read_text(encoding="utf-8"))["robots"]
    assert told["1"]["carries"] == "laser"
    for robot in told.values():
        keys = {"source", "odometry", "sightings", "dropped", "down_weighted", "nis_median", "warnings", "verdict"}
        assert keys <= set(robot)
        assert robot["sightings"] > 50
        assert Path(robot["source"]).exists()
    assert [told[k]["odometry"] for k in "123"] == ["poses", "velocity", "velocity"]
    assert [told[k]["scans"] > 0 for k in "123"] == [True, False, False]
    assert told["1"]["nis_median"] is None
    assert 0.1 < told["2"]["nis_median"] < 3
    assert told["2"]["carries"] == "wheels, camera"
    assert "robot 1" in result.summary()
    assert "<img" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_files_one_by_one_are_the_folder(made, team):
    result, _ = made
    paths = [team / "robot1.mcap", team / "sightings.csv", team / "odometry.csv"]
    again = mapweave.map(paths)
    np.testing.assert_array_equal(again.maps[0].landmarks.mean, result.maps[0].landmarks.mean)
    np.testing.assert_array_equal(again.grids[0].hits, result.grids[0].hits)


def test_a_landmark_data_set_and_a_laser_log_are_one_call(team, tmp_path):
    data = tmp_path / "cameras"
    data.mkdir()
    shutil.copy(team / "odometry.csv", data)
    rows = (team / "sightings.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    own = [row for row in rows if "robot1" not in row]
    (data / "sightings.csv").write_text("".join(own), encoding="utf-8")
    extra = tmp_path / "seen.csv"
    extra.write_text("".join([rows[0], *(row for row in rows if "robot1" in row)]), encoding="utf-8")
    logs = [data, team / "robot1.mcap", extra]
    assert is_mixed(logs)
    found = sorted_logs(logs, LaserSource())
    assert list(found.lasers) == ["robot1"]
    assert mapweave.map(logs).maps[0].robots == ("robot1", "robot2", "robot3")


def test_a_laser_clock_an_hour_off_is_named_and_its_robot_stays_apart(team, tmp_path):
    home = tmp_path / "late"
    shutil.copytree(team, home)
    log = read_laser(home / "robot1.mcap", "1")
    rows = replace(log.odometry, t=log.odometry.t + 3600.0)
    write_mcap(home / "robot1.mcap", replace(log, scan_t=log.scan_t + 3600.0, odometry=rows))
    result = mapweave.map(home)
    assert [team.robots for team in result.maps] == [("robot2", "robot3"), ("robot1",)]
    (said,) = [w for w in result.metrics["warnings"] if "clock" in w]
    assert said.startswith("robot 1: its clock has nothing in common with the others'")


def test_a_robot_that_is_left_out_is_no_landmark(team):
    seen = {row.split(",")[2] for row in (team / "sightings.csv").read_text().splitlines() if row.split(",")[1] == "3"}
    assert "robot2" in seen
    done = mapweave.map(team, robots=["1", "3"])
    names = {name for team_map in done.maps for name in team_map.landmarks.ids}
    assert len(names) > 3
    assert names <= seen - {"robot1", "robot2"}
    assert done.metrics["robots"]["3"]["dropped"]["sighting of a robot left out"] > 10


def test_between_which_scales_wheels_are_used_is_asked_by_the_settings(made, team):
    result, _ = made
    narrow = mapweave.map(team, config={"agreement": {"turn_scale": [0.1, 0.5]}})
    usual, told = ({(f.code, f.robot) for f in r.findings if f.robot in {"2", "3"}} for r in (result, narrow))
    assert ("turns-unlike", "2") in told - usual


def test_what_cannot_be_is_refused_with_the_reason(team, tmp_path):
    wrong = tmp_path / "calibration.json"
    wrong.write_text('{"9": {"lag": {"value": 0.1}}}', encoding="utf-8")
    with pytest.raises(UsageError, match="no robot 9; there are 1, 2, 3"):
        mapweave.map(team, calibration=wrong)
    with pytest.raises(DataError, match="--robots: no robot 7"):
        mapweave.map(team, robots=["7"])
    with pytest.raises(UsageError, match="over 1000 maps on the way"):
        mapweave.map(team, every=1e-3)
    with pytest.raises(UsageError, match="--radios, --resume: not for mixed teams"):  # they were passed over in silence
        mapweave.map(team, radios={"n_7": "robot1"}, laser=mapweave.LaserOptions(resume=team))
    with pytest.raises(UsageError, match="mixed teams know graph"):
        mapweave.map(team, method="ekf")
    odd = tmp_path / "notes.txt"
    odd.write_text("nothing", encoding="utf-8")
    with pytest.raises(ReaderError, match="expected a log of a known format, found text that begins 'nothing'"):
        mapweave.map([team / "sightings.csv", odd])
    twice = tmp_path / "robot1.mcap"
    shutil.copy(team / "robot1.mcap", twice)
    with pytest.raises(DataError, match="robot1 has the laser log"):
        mapweave.map([team, twice])


def test_a_mixed_team_is_not_fused_and_is_called_what_it_is(made):
    result, folder = made
    for given in (folder, [result, result]):
        with pytest.raises(MapweaveError, match="expected a result of laser logs, found one of a mixed team"):
            mapweave.fuse(given)


def test_one_kind_of_log_is_no_mixed_team(team):
    assert is_mixed([team])
    assert not is_mixed([team / "robot1.mcap"])
    assert is_mixed([team / "robot1.mcap", team / "sightings.csv"])
