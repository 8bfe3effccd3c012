"""What wheels are worth, and what matches of few returns are worth beside them."""

import numpy as np
import pytest

from mapweave.laser.keyframes import StepNoise, wheel_noise
from mapweave.laser.wheel_worth import WheelWorth, _least_held

STILL = np.zeros(3)
STEP = np.array([0.2, 0.0, 0.0])
SD = np.array([0.09, 0.09, 0.06])
WALLS = np.diag([1e4, 1e4, 1e4])
MANY, FEW = 0.9, 0.4


def learned(rng: np.random.Generator, wheels_err: float, few_err: float, steps: int = 400) -> WheelWorth:
    """Every second scan matches with few returns; both kinds err by so many of the sd that any wheels may."""
    worth = WheelWorth(lambda step: wheel_noise(step, StepNoise()))
    for _ in range(steps):
        innovation = rng.normal(0.0, wheels_err, 3) * SD
        worth.see(STEP, innovation, SD, WALLS, 1e4)
        worth.few(MANY, STEP, innovation, SD)
        worth.few(FEW, STEP, rng.normal(0.0, few_err, 3) * SD, SD)
    return worth


def test_a_match_of_few_returns_is_believed_as_much_less_as_it_errs_more():
    worth = learned(np.random.default_rng(1), 0.01, 0.5)
    off = worth.few(FEW, STILL, SD, SD)
    many = (0.01**2 * 400 + 4) / 404
    few = (0.5**2 * 400 + 4) / 404
    assert off[2] / SD[2] == pytest.approx(many / few, rel=0.3)
    assert off[0] == off[1]
    assert 0.0 < off[0] < 0.15 * SD[0]


def test_a_match_of_many_returns_is_believed_whole():
    worth = learned(np.random.default_rng(2), 0.01, 0.5)
    assert worth.few(MANY, STILL, SD, SD) is SD


def test_wheels_that_have_not_proven_good_take_nothing_from_a_match():
    fresh = WheelWorth(lambda step: wheel_noise(step, StepNoise()))
    assert fresh.few(FEW, STILL, SD, SD) is SD
    poor = learned(np.random.default_rng(3), 0.8, 2.0)
    assert poor.few(FEW, STILL, SD, SD) is SD


def test_few_returns_that_err_as_many_do_are_believed_as_they_are():
    worth = learned(np.random.default_rng(4), 0.01, 0.01)
    np.testing.assert_allclose(worth.few(FEW, STILL, SD, SD), SD, rtol=0.2)
    assert worth.few(FEW, STILL, SD, SD) is not SD


def test_a_robot_that_stands_tells_nothing():
    worth = learned(np.random.default_rng(6), 0.01, 0.5)
    before = worth.few(FEW, np.zeros(3), SD, SD)
    for _ in range(200):
        worth.few(FEW, np.zeros(3), np.zeros(3), SD)
    np.testing.assert_array_equal(worth.few(FEW, np.zeros(3), SD, SD), before)


def test_the_least_held_direction_is_that_of_walls_with_any_heading():
    rng = np.random.default_rng(1)
    for rows in (1, 2, 9):
        J = rng.normal(size=(rows, 3)) * [30.0, 30.0, 100.0]
        lines = J.T @ J
        held = lines[:2, :2] - np.outer(lines[:2, 2], lines[:2, 2]) / lines[2, 2]
        assert _least_held(lines) == pytest.approx(np.linalg.eigvalsh(held)[0], rel=1e-6, abs=1e-9)
