"""The factor on odometry's errors reaches the world, the graph's steps and what scan odometry lets wheels err by."""

import pytest

from mapweave.exploration.laser.config import LaserMissionConfig, with_odometry_noise


@pytest.mark.parametrize(("factor", "wider"), [(9.0, 9.0), (1.0, 1.0), (0.25, 1.0)])
def test_the_front_end_lets_worse_wheels_err_more_and_better_ones_as_before(factor, wider):
    cfg = LaserMissionConfig()
    made = with_odometry_noise(cfg, factor)
    for name in ("sd_xy", "sd_xy_per_m", "sd_turn", "sd_turn_per_m", "sd_turn_per_rad"):
        assert getattr(made.team.front_end, name) == pytest.approx(wider * getattr(cfg.team.front_end, name))
    assert made.robots.odometry.factor == factor * cfg.robots.odometry.factor
    before, after = cfg.team.graph.keyframes.noise, made.team.graph.keyframes.noise
    for name in ("wheels_xy", "wheels_turn", "wheels_turn_per_m"):
        assert getattr(after, name) == pytest.approx(factor * getattr(before, name))
