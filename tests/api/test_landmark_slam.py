"""Rows that come one by one: the same map as of their tables, the filter's poses on the way, bad rows refused."""

import json

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import DataError, UsageError
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.local_map import read_local_map


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("team")
    mapweave.simulate_landmarks(folder / "team", robots=1, landmarks=8, minutes=0.5, seed=1)
    return read_landmark_logs(folder / "team")[0]


def rows(log):
    """Velocities and sightings in order of time, velocities first."""
    o, s = log.odometry, log.sightings
    driven = [(t, 0, "add_odometry", (t, v, w)) for t, v, w in zip(o.t, o.v, o.w, strict=True)]
    seen = [
        (t, 1, "add_sighting", (t, s.ids[k], r, b)) for t, k, r, b in zip(s.t, s.what, s.range, s.bearing, strict=True)
    ]
    return [(name, args) for _, _, name, args in sorted(driven + seen, key=lambda row: row[:2])]


def test_rows_one_by_one_give_the_map_of_their_tables_and_the_poses_of_the_filter(log, tmp_path):
    slam = mapweave.LandmarkSlam()
    every = rows(log)
    for k, (name, args) in enumerate(every):
        pose, cov = getattr(slam, name)(*args)
        assert abs(pose[2]) <= np.pi
        if k == len(every) // 2:
            slam.result()
            half = len(slam.landmarks().ids)
    o, s = log.odometry, log.sightings
    driven = {"t": o.t, "robot": np.ones(len(o.t), int), "v": o.v, "w": o.w}
    named = [s.ids[k] for k in s.what]
    seen = {"t": s.t, "robot": np.ones(len(s), int), "id": named, "range": s.range, "bearing": s.bearing}
    made = mapweave.map(odometry=driven, sightings=seen)
    ours = slam.save(tmp_path / "slam")
    assert np.array_equal(ours.maps[0].landmarks.mean, made.maps[0].landmarks.mean)
    made.write(tmp_path / "map")
    for name in ("landmarks.csv", "trajectories/robot1.tum"):
        assert (tmp_path / "slam" / name).read_bytes() == (tmp_path / "map" / name).read_bytes()
    assert 0 < half <= len(slam.landmarks().ids) == len(made.maps[0].landmarks.ids)
    end = made.maps[0].tracks["robot1"]
    assert np.hypot(*(pose - end.pose[-1])[:2]) < 0.3
    assert np.linalg.eigvalsh(cov).min() > 0


def test_a_row_that_cannot_be_is_refused_and_leaves_the_map_as_it_was(log):
    slam = mapweave.LandmarkSlam(robot="2")
    assert np.array_equal(slam.pose.pose, np.zeros(3))
    assert slam.landmarks().ids == ()
    with pytest.raises(DataError, match="no sighting came yet"):
        slam.result()
    slam.add_odometry(1.0, 0.5, 0.0)
    before = slam.add_odometry(2.0, 0.5, 0.0).pose
    assert before == pytest.approx([0.5, 0.0, 0.0], abs=0.1)
    for name, args, said in (
        ("add_odometry", (1.5, 0.5, 0.0), "from the latest one on"),
        ("add_odometry", (3.0, np.nan, 0.0), "finite"),
        ("add_sighting", (1.5, "post", 1.0, 0.0), "from the latest one on"),
        ("add_sighting", (3.0, "post", np.inf, 0.0), "finite"),
        ("add_sighting", (3.0, " ", 1.0, 0.0), "expected an id"),
        ("add_sighting", (3.0, "two\nlines", 1.0, 0.0), "expected an id"),
        ("add_odometry", (3.0, 1e300, 0.0), "velocities of a robot"),
        ("add_odometry", (3.0, 0.5, -2e3), "velocities of a robot"),
        ("add_sighting", (3.0, "post", 0.0, 0.0), "expected a distance"),
        ("add_sighting", (3.0, "post", 1e300, 0.0), "expected a distance"),
        ("add_sighting", (3.0, "post", 1.0, 1e300), "expected a distance"),
    ):
        with pytest.raises(DataError, match=said) as told:
            getattr(slam, name)(*(np.float64(a) if isinstance(a, float) else a for a in args))
        assert "np." not in str(told.value)
    assert np.array_equal(slam.pose.pose, before)
    for name in ("left", "", "-1"):
        for slam_of in (mapweave.LandmarkSlam, mapweave.LaserSlam):
            with pytest.raises(UsageError, match="whole number"):
                slam_of(robot=name)
    for wrong, said in (
        (lambda: mapweave.LandmarkSlam(robot=1), "robot: expected text, found int"),
        (lambda: slam.add_sighting(3.0, 7, 1.0, 0.0), "landmark: expected text, found int"),
        (lambda: slam.add_sighting(3.0, "post", np.ones(1), 0.0), "distance: expected a number, found ndarray"),
        (lambda: slam.add_odometry(None, 0.5, 0.0), "t: expected a number, found None"),
        (lambda: mapweave.LaserSlam().add_scan(None, [1.0, 1.0], [0.0, 0.1]), "t: expected a number, found None"),
    ):
        with pytest.raises(UsageError, match=said):
            wrong()


def test_a_map_of_which_hardly_a_sighting_is_left_is_not_good():
    slam = mapweave.LandmarkSlam()
    for k in range(50):  # both turn and come along with the robot, as no landmark does
        slam.add_odometry(0.1 * k, 0.5, 0.1)
        slam.add_sighting(0.1 * k, "a", 2.0, 0.1)
        slam.add_sighting(0.1 * k, "b", 3.0, -0.5)
    result = slam.result()
    assert result.maps[0].landmarks.ids == ()
    assert {f.code for f in result.findings} == {"sightings-doubted"}
    assert result.verdict == "doubtful"


def test_what_one_robot_saw_of_others_stays_in_its_local_map(log, tmp_path):
    """Robot 7 stands where the first landmark does."""
    slam = mapweave.LandmarkSlam()
    first = log.sightings.ids[log.sightings.what[0]]
    times = 0
    for name, args in rows(log):
        getattr(slam, name)(*args)
        if args[1] == first:
            slam.add_sighting(args[0], "robot7", *args[2:])
            slam.add_sighting(args[0], "robot1", *args[2:])
            times += 1
    slam.save(tmp_path / "one")
    seen = read_local_map(tmp_path / "one" / "local" / "robot1").robot_sightings
    assert set(seen.target) == {"robot7"}
    assert len(seen.t) > 0.8 * times
    told = json.loads((tmp_path / "one" / "metrics.json").read_text(encoding="utf-8"))["robots"]["1"]
    assert told["dropped"]["sighting of itself or of no robot"] == times
