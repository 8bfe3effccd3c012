"""Robots of a landmark team that nothing ties to the others but that they see each other."""

import numpy as np

import mapweave


def test_a_robot_that_is_only_seen_is_in_the_map_as_sure_as_it_is_right(tmp_path):
    team = tmp_path / "team"
    mapweave.simulate_landmarks(team, robots=4, landmarks=8, minutes=2.0, seed=11)
    (team / "Robot4_Measurement.dat").write_text("")
    result = mapweave.map(team, truth=team)
    assert result.metrics["components"] == [["1", "2", "3", "4"]]
    assert result.metrics["evaluation"]["robots"]["4"]["ate"] < 0.4
    sd = np.sqrt(np.trace(result.maps[0].tracks["robot4"].cov[:, :2, :2], axis1=1, axis2=2))
    assert 0.05 < np.median(sd) < 1.0


def test_robots_that_see_nothing_but_each_other_make_one_map(tmp_path):
    team = tmp_path / "team"
    mapweave.simulate_landmarks(team, robots=4, landmarks=0, minutes=2.0, seed=11)
    result = mapweave.map(team, truth=team)
    assert result.metrics["components"] == [["1", "2", "3", "4"]]
    assert all(robot["ate"] < 0.5 for robot in result.metrics["evaluation"]["robots"].values())
