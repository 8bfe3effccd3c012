"""Landmarks and trajectories to files and back."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mapweave.api.map_laser import LaserMapConfig
from mapweave.core.config import load
from mapweave.core.errors import DataError, ReaderError
from mapweave.core.names import in_order, robot_key, robot_name
from mapweave.core.records import Track
from mapweave.exploration.laser.config import find_laser_scenario
from mapweave.io.decisions import read_decisions
from mapweave.io.directory import read_json, write_json
from mapweave.io.npz import write_npz
from mapweave.io.team_map import read_members, read_team_maps, told_gaps, write_landmarks, write_tracks
from mapweave.io.tum import read_tum, write_track_covariance, write_tum
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.team_map import TeamMap


def a_team():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    t = np.linspace(1.2e9, 1.2e9 + 10, 50)
    cov = np.tile(np.diag([1e-4, 2e-4, 3e-4]), (50, 1, 1))
    track = Track(t, np.column_stack([t - t[0], np.zeros(50), np.linspace(-3, 3, 50)]), cov)
    landmarks = LandmarkMap(("11", "6", "barcode:90"), rng.normal(size=(3, 2)), A @ A.T)
    members = {"11": ("robot10", "robot2"), "6": ("robot2",), "barcode:90": ("robot2",)}
    tracks = {"robot2": track, "robot10": track}
    return TeamMap(("robot2", "robot10"), landmarks, tracks, members, {"11": 5, "6": 2, "barcode:90": 30})


def test_a_team_map_written_and_read_back_is_the_same(tmp_path):
    team = a_team()
    write_landmarks(tmp_path, team)
    write_tracks(tmp_path, team)
    (back,) = read_team_maps(tmp_path)
    assert back.robots == team.robots
    assert back.landmarks.ids == ("6", "11", "barcode:90")
    same = team.landmarks.select(back.landmarks.ids)
    assert np.array_equal(back.landmarks.mean, same.mean)
    assert np.array_equal(back.landmarks.cov, same.cov)
    assert {k: sorted(v) for k, v in back.members.items()} == {k: sorted(v) for k, v in team.members.items()}
    assert back.sightings == team.sightings
    assert np.abs(back.tracks["robot2"].pose - team.tracks["robot2"].pose).max() < 1e-6
    head = (tmp_path / "landmarks.csv").read_text().splitlines()
    assert head[0] == "id,x,y,var_x,cov_xy,var_y,robots,sightings"
    assert head[2].endswith(",2;10,5")


def test_robots_of_folders_with_any_name_are_read_back(tmp_path):
    names = ("robot2", "a;b/robot1", "back\\slash;/robot3", ";", "\\", 'x,y "z"/robot4')
    team = a_team()
    members = dict.fromkeys(team.landmarks.ids, names)
    write_landmarks(tmp_path, replace(team, members=members))
    back, _ = read_members(tmp_path / "landmarks.csv")
    assert {k: sorted(v) for k, v in back.items()} == {k: sorted(v) for k, v in members.items()}


def test_the_same_arrays_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_npz(tmp_path / f"{name}.npz", x=np.arange(5.0), ids=np.array(["a", "bb"]))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as held:
        assert list(held["ids"]) == ["a", "bb"]


def test_covariances_stand_line_by_line_beside_the_poses(tmp_path):
    track = a_team().tracks["robot2"]
    write_track_covariance(tmp_path / "t.cov.csv", track)
    lines = (tmp_path / "t.cov.csv").read_text().splitlines()
    assert lines[0] == "t,xx,xy,yy,xt,yt,tt"
    assert len(lines) == 51
    assert [float(v) for v in lines[1].split(",")[1:]] == [1e-4, 0, 2e-4, 0, 0, 3e-4]


def test_a_trajectory_that_goes_back_in_time_is_refused(tmp_path):
    with pytest.raises(DataError, match="ascend"):
        write_tum(tmp_path / "t.tum", Track(np.array([1.0, 1.0]), np.zeros((2, 3))))


@pytest.mark.parametrize("line", ["1 2 3", "1 2 3 0 0 0 zero 1", "1 nan 3 0 0 0 0 1"])
def test_a_broken_tum_line_is_named(tmp_path, line):
    path = tmp_path / "t.tum"
    path.write_text(f"# t x y z qx qy qz qw\n0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(ReaderError, match=r"t\.tum:3"):
        read_tum(path)


def test_a_robot_that_nothing_places_has_an_empty_trajectory_and_a_lost_one_is_refused(tmp_path):
    nowhere = Track(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    team = replace(a_team(), tracks={**a_team().tracks, "robot3": nowhere})
    write_tracks(tmp_path, team)
    (back,) = read_team_maps(tmp_path)
    assert len(back.tracks["robot3"].t) == 0
    (tmp_path / "trajectories" / "robot2.tum").write_bytes(b"")
    with pytest.raises(ReaderError, match=r"robot2\.tum: expected a trajectory, found no poses"):
        read_team_maps(tmp_path)


def test_text_that_begins_with_a_mark_of_its_encoding_is_read(tmp_path):
    path = tmp_path / "file"
    for text, read in (
        ("0 1 2 0 0 0 0 1\n", lambda path: read_tum(path).pose[0, 0] == 1.0),
        ("[laser]\nparticles = 7\n", lambda path: load(LaserMapConfig, path).laser.particles == 7),
        ('[logs]\n1 = "a"\n', lambda path: read_decisions(path).logs == {"1": "a"}),
        ('sensor = "laser"\noffice = 500\n', lambda path: find_laser_scenario(str(path)).office == 500),
        ('{"a": 1}', lambda path: read_json(path) == {"a": 1}),
    ):
        path.write_text(text, encoding="utf-8-sig")
        assert read(path), text


def test_numbers_in_names_are_put_in_order_as_numbers():
    assert sorted(["11", "6", "barcode:90", "barcode:7"], key=in_order) == ["6", "11", "barcode:7", "barcode:90"]
    assert sorted({"1", "01", "a10", "a9", "001"}, key=in_order) == ["001", "01", "1", "a9", "a10"]
    assert sorted(["b/robot2", "a/robot11", "a/robot2"], key=in_order) == ["a/robot2", "a/robot11", "b/robot2"]
    assert robot_key("robot3") == "3"
    assert robot_name("3") == "robot3"
    assert robot_name("run/robot3") == robot_key("run/robot3") == "run/robot3"


def test_a_written_trajectory_is_a_tum_file_to_a_reader_that_knows_only_the_format(tmp_path):
    t, heading = 1.7e9 + np.arange(4.0), np.array([0.0, 1.0, -3.0, 3.1])
    write_tum(tmp_path / "r.tum", Track(t, np.column_stack([t - t[0], -t + t[0], heading])))
    rows = np.loadtxt(tmp_path / "r.tum")
    assert rows.shape == (4, 8)
    np.testing.assert_allclose(rows[:, :4], np.column_stack([t, t - t[0], -t + t[0], np.zeros(4)]), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-8)
    np.testing.assert_allclose(Rotation.from_quat(rows[:, 4:]).as_euler("zyx")[:, 0], heading, atol=1e-8)


def test_spans_that_are_left_out_come_back_from_the_metrics(tmp_path):
    team = replace(a_team(), left_out={"robot2": ((1.2e9 + 1.5, 1.2e9 + 4.25),), "robot10": ()})
    write_landmarks(tmp_path, team)
    write_tracks(tmp_path, team)
    write_json(tmp_path / "metrics.json", {"version": "0", "left_out": told_gaps([team])})
    (back,) = read_team_maps(tmp_path)
    assert back.left_out == {"robot2": ((1.2e9 + 1.5, 1.2e9 + 4.25),)}
    write_json(tmp_path / "metrics.json", {"version": "0", "left_out": {"2": [3.0]}})
    with pytest.raises(ReaderError, match=r"metrics\.json: left_out: expected lists of"):
        read_team_maps(tmp_path)


def _moved(text):
    return re.sub(r"(?m)^6,[^,]*", "6,5.0", text)


def _half(text):
    return "".join(text.splitlines(keepends=True)[:25])


def _no_variance(text):
    return text.replace("1.000000e-04", "-1.000000e-04")


@pytest.mark.parametrize(
    ("name", "spoilt"),
    [
        ("trajectories/robot2.tum", _half),
        ("trajectories/robot2.tum", lambda text: re.sub(r"(?m)^1200000000\.0", "1200000000.1", text)),
        ("trajectories/robot2.tum", lambda text: re.sub(r"0 0 0 \S+ \S+", "0 0 0 0 0", text, count=1)),
        ("trajectories/robot2.cov.csv", _half),
        ("trajectories/robot2.cov.csv", _no_variance),
        ("trajectories/robot2.cov.csv", lambda text: text.replace("2.000000e-04", "nan", 1)),
        ("landmarks.csv", _moved),
    ],
)
def test_a_result_whose_files_contradict_each_other_is_refused(tmp_path, name, spoilt):
    team = a_team()
    write_landmarks(tmp_path, team)
    write_tracks(tmp_path, team)
    assert len(read_team_maps(tmp_path)) == 1
    path = tmp_path / name
    before = path.read_text()
    path.write_text(spoilt(before))
    assert path.read_text() != before
    with pytest.raises(ReaderError, match=r"robot2|landmarks\.csv"):
        read_team_maps(tmp_path)


@pytest.mark.parametrize("wrong", [-np.eye(6), np.eye(6) + 5.0 * np.eye(6, k=1)])
def test_landmarks_with_what_is_no_covariance_are_refused(tmp_path, wrong):
    write_landmarks(tmp_path, replace(a_team(), landmarks=replace(a_team().landmarks, cov=wrong)))
    with pytest.raises(ReaderError, match=r"landmarks\.npz: cov"):
        read_team_maps(tmp_path)
