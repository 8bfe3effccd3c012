"""A report of a team larger than any figure has room for."""

import warnings

import pytest

import mapweave

pytestmark = pytest.mark.drawn


@pytest.mark.slow
def test_the_report_of_many_robots_is_drawn_without_complaint(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=16, landmarks=60, minutes=0.7, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        mapweave.map(tmp_path / "team", tmp_path / "out", truth=tmp_path / "team")
    assert (tmp_path / "out" / "figures" / "local_maps.png").stat().st_size < 400_000
