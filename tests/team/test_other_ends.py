"""Teams that are smoothed from far starts, whose problem has more ends than one."""

import pytest

import mapweave

NOISY = {"bearings": 0, "noise": 2.0, "outliers": 0.15, "landmarks": 15, "bearing_cameras": 2}


@pytest.mark.slow
def test_of_all_ends_the_one_that_fits_best_is_the_map(tmp_path):
    team = tmp_path / "team"
    mapweave.simulate_team(team, seed=24, lasers=2, cameras=1, minutes=2.5, **NOISY)
    for log in team.glob("*.mcap"):
        log.unlink()
    result = mapweave.map(team)
    assert {f.code for f in result.findings} >= {"placed-anew"}
    assert result.verdict == "good"
    assert mapweave.evaluate(result, team / "truth").metrics["landmark_rmse"] < 0.4


@pytest.mark.slow
def test_an_end_elsewhere_that_fits_about_as_well_is_told(tmp_path):
    team = tmp_path / "team"
    mapweave.simulate_team(team, seed=20, lasers=3, cameras=2, rooms=2, minutes=1.5, calibration="random", **NOISY)
    result = mapweave.map(team)
    assert "fits-otherwise" in {f.code for f in result.findings}
    assert result.verdict == "doubtful"
