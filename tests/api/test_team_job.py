"""The landmark job end to end: simulated teams, and real ones where the logs are at hand."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import mapweave
from mapweave.api.fuse import distinct_names
from mapweave.api.team import carried
from mapweave.core import se2
from mapweave.core.errors import DataError, UsageError
from mapweave.core.records import Track


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (1.3, True)])
def test_a_robot_whose_camera_and_wheels_have_another_unit_makes_a_map_doubtful(tmp_path, factor, told):
    mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=10, minutes=2.0, seed=3)
    tables = mapweave.read(tmp_path / "team").tables()
    drives, seen = tables["velocities"], tables["sightings"]
    drives["v"] = np.where(drives["robot"] == "2", factor, 1.0) * drives["v"]
    seen["range"] = np.where(seen["robot"] == "2", factor, 1.0) * seen["range"]
    made = mapweave.map(None, tmp_path / "made", odometry=drives, sightings=seen, refine=False)
    for result in (made, mapweave.fuse([tmp_path / "made"])):
        assert any(f.code == "maps-scales" for f in result.findings) == told


@pytest.mark.slow
def test_fused_maps_of_simulated_teams_are_as_good_as_they_say_and_better_than_their_mean(tmp_path):
    scores = []
    for seed in range(8):
        team = tmp_path / f"team{seed}"
        mapweave.simulate_landmarks(team, robots=3, landmarks=15, minutes=4, seed=seed)
        scores.append(mapweave.map(team, truth=team).score)
    nees = [s.landmarks.nees_per_dof for s in scores]
    assert 0.6 < np.mean(nees) < 1.4
    assert max(nees) < 3
    fused = np.mean([s.landmarks.rmse for s in scores])
    assert fused < 0.09
    assert fused < 0.8 * np.mean([s.naive_rmse for s in scores])
    assert fused < 0.6 * np.mean([s.mean_single_rmse for s in scores])


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    folder = tmp_path_factory.mktemp("team") / "team"
    mapweave.simulate_landmarks(folder, robots=3, landmarks=12, minutes=2, seed=9)
    return folder


def test_any_executor_gives_the_same_map(team):
    here = mapweave.map(team)
    with ThreadPoolExecutor(2) as pool:
        there = mapweave.map(team, executor=pool)
    assert np.array_equal(here.maps[0].landmarks.mean, there.maps[0].landmarks.mean)
    assert np.array_equal(here.maps[0].landmarks.cov, there.maps[0].landmarks.cov)


@pytest.mark.slow
def test_barcodes_exchanged_in_the_table_are_named_by_evaluate(team, tmp_path):
    out = tmp_path / "out"
    mapweave.map(team, out)
    table = (team / "Landmark_Groundtruth.dat").read_text().splitlines()
    rows = [line.split() for line in table if not line.startswith("#")]
    ids = set(mapweave.evaluate(out, team).score.landmarks.ids)
    a, b = (row for row in rows if row[0] in ids and row[0] in (min(ids), max(ids)))
    a[0], b[0] = b[0], a[0]
    survey = tmp_path / "survey.csv"
    survey.write_text("id,x,y\n" + "".join(f"{r[0]},{r[1]},{r[2]}\n" for r in rows))
    told = mapweave.evaluate(out, survey).as_json()
    assert [{*row[:2]} for row in told["exchanged"]] == [{a[0], b[0]}]
    assert told["landmark_rmse_exchanged"] < 0.5 * told["landmark_rmse"]
    assert any("look exchanged" in line for line in mapweave.evaluate(out, survey).lines())


def test_half_of_a_robots_time_is_less_of_its_sightings(team):
    whole, half = mapweave.map(team), mapweave.map(team, share={"2": 0.5})
    seen = [{m.robot: sum(m.sightings.values()) for m in r.local} for r in (whole, half)]
    assert seen[1]["robot2"] < 0.8 * seen[0]["robot2"]
    assert seen[1]["robot1"] == seen[0]["robot1"]


def test_two_data_sets_with_the_same_robots_are_not_mixed(team):
    with pytest.raises(DataError, match="two data sets are mixed"):
        mapweave.map([team, team])


def test_folders_are_told_apart_by_as_much_of_their_path_as_it_takes(tmp_path):
    assert distinct_names([tmp_path / "a", tmp_path / "b"]) == ["a", "b"]
    assert distinct_names([tmp_path / "x" / "a", tmp_path / "y" / "a"]) == ["x/a", "y/a"]
    with pytest.raises(UsageError, match="twice"):
        distinct_names([tmp_path / "a", tmp_path / "a"])


def test_a_carried_trajectory_has_the_covariance_that_sampling_gives():
    rng = np.random.default_rng(0)
    T, T_cov = np.array([1.0, 2.0, 0.7]), np.diag([0.01, 0.02, 0.001])
    pose, cov = np.array([3.0, -1.0, 0.4]), np.diag([0.02, 0.01, 0.002])
    frames = rng.multivariate_normal(T, T_cov, 200_000)
    poses = rng.multivariate_normal(pose, cov, 200_000) / [1.25, 1.25, 1.0]
    sampled = np.cov(se2.compose(frames, poses).T)
    made = carried(Track(np.zeros(1), pose[None], cov[None]), T, T_cov, 1.25, 1.0)
    assert np.allclose(made.pose[0], se2.compose(T, pose / [1.25, 1.25, 1.0]))
    assert np.abs(made.cov[0] - sampled).max() < 0.03 * np.abs(sampled).max()


@pytest.mark.data
@pytest.mark.slow
def test_real_teams_are_mapped_as_well_and_as_honestly_as_promised(data):
    nees = []
    for number, goal in ((1, 0.045), (3, 0.048), (4, 0.042), (6, 0.045)):
        archive = data / "mrclam" / f"MRCLAM_Dataset{number}.zip"
        told = mapweave.map(archive, refine=False, truth=archive).metrics["evaluation"]
        swapped = told["exchanged"] != []
        assert swapped == (number == 1)
        if swapped:
            assert told["exchanged"][0][:2] == ["11", "17"]
        assert told["landmark_rmse_exchanged" if swapped else "landmark_rmse"] <= goal
        nees.append(told["nees_per_dof_exchanged" if swapped else "nees_per_dof"])
        assert 0.5 <= nees[-1] <= 3
    assert np.mean(nees) <= 1.8
