"""Numbers that are not finite stop at the writers: an error that names the file, and nothing half-written."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.errors import EstimateError
from mapweave.core.records import Track
from mapweave.io.directory import result_directory, write_json
from mapweave.io.g2o import write_g2o
from mapweave.io.laser_map import write_laser_map
from mapweave.io.table import read_table, write_table
from mapweave.io.team_map import write_landmark_arrays
from mapweave.io.tum import write_track_covariance, write_tum
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.laser.pose_graph import PoseGraph

from .made_laser_map import made_laser_map

BAD = (np.nan, np.inf, -np.inf)


def track(value):
    pose = np.zeros((3, 3))
    pose[1, 0] = value
    return Track(np.arange(3.0), pose, np.full((3, 3, 3), value))


@pytest.mark.parametrize("value", BAD)
def test_a_trajectory_with_a_number_that_is_not_finite_names_robot_and_row(tmp_path, value):
    path = tmp_path / "trajectories" / "robot2.tum"
    with pytest.raises(EstimateError, match=r"^trajectories/robot2\.tum: row 2 would hold a number that is not finite"):
        write_tum(path, track(value))
    with pytest.raises(EstimateError, match=r"^trajectories/robot2\.cov\.csv: row 1 would hold"):
        write_track_covariance(path.with_name("robot2.cov.csv"), track(value))


def test_a_pose_graph_and_saved_arrays_are_refused_too(tmp_path):
    graph = PoseGraph(
        np.full((1, 3), np.nan), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3))
    )
    with pytest.raises(EstimateError, match=r"robot1/pose_graph\.g2o: row 1"):
        write_g2o(tmp_path / "robot1" / "pose_graph.g2o", graph)
    marks = LandmarkMap(("1",), np.array([[0.0, np.inf]]), np.eye(2))
    with pytest.raises(EstimateError, match=r"landmarks\.npz: mean would hold numbers that are not finite"):
        write_landmark_arrays(tmp_path, marks)
    assert not (tmp_path / "landmarks.npz").exists()


def test_a_table_leaves_out_what_is_not_known_and_refuses_what_is_infinite(tmp_path):
    path = tmp_path / "robot3" / "scans.csv"
    write_table(path, ("id", "x", "y"), [["a,b", np.nan, None], ["$\\frac", 1.5, True], ['say "no"', 2, np.float64(3)]])
    assert path.read_text() == 'id,x,y\n"a,b",,\n$\\frac,1.500000000,true\n"say ""no""",2,3.000000000\n'
    assert list(read_table(path).columns["id"]) == ["a,b", "$\\frac", 'say "no"']
    held = path.read_bytes()
    with pytest.raises(EstimateError, match=r"robot3/scans\.csv: a number is infinite, where id,x stand"):
        write_table(path, ("id", "x"), [["a", 1.0], ["b", np.inf]])
    assert path.read_bytes() == held
    assert [p.name for p in path.parent.iterdir()] == ["scans.csv"]


def test_a_figure_that_does_not_exist_is_null(tmp_path):
    write_json(tmp_path / "m.json", {"a": np.nan, "b": [np.inf, np.float32("nan")], "c": np.array([1.0, -np.inf])})
    assert json.loads((tmp_path / "m.json").read_text()) == {"a": None, "b": [None, None], "c": [1.0, None]}


def test_a_result_that_cannot_be_written_leaves_the_earlier_one(tmp_path):
    out = tmp_path / "out"
    with result_directory(out) as work:
        write_json(work / "metrics.json", {"version": "1"})
        write_laser_map(work, made_laser_map())
    held = {p.name: p.read_bytes() for p in out.iterdir()}
    made = made_laser_map()
    broken = replace(made, scans=replace(made.scans, pose=np.full_like(made.scans.pose, np.nan)))

    def written():
        with result_directory(out) as work:
            write_json(work / "metrics.json", {"version": "2"})
            write_laser_map(work, broken)

    with pytest.raises(EstimateError):
        written()
    assert {p.name: p.read_bytes() for p in out.iterdir()} == held
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
