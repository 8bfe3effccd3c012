"""A stranger who floods a team of honest robots: the map process stays small, and hears every one of them."""

import pytest

import live as load


@pytest.mark.slow
def test_a_flooding_stranger_takes_no_memory_and_costs_honest_robots_nothing_they_told(monkeypatch):
    monkeypatch.setitem(load.WAYS, "laser", 2)
    told = load.measured("laser", 10, 1.0, 10.0, flood=True)
    assert told["memory_MB"] < 500
    assert told["lost"] == 0
    assert told["refused"]["not expected"] > 100
