"""Commands integrated: exact on arcs, with derivatives by speed scale, turn scale and lag."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Odometry
from mapweave.team.config import MotionNoise
from mapweave.team.robot_part import MOTION_LOST_XY, MOTION_REST_XY, CommandedMotion, random_walk


@pytest.fixture
def motion():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.01, 0.3, 60))
    return CommandedMotion.of(Odometry(t, rng.uniform(0.0, 0.4, 60), rng.uniform(-1.0, 1.0, 60)), 2.0)


def test_a_constant_command_drives_a_circle():
    motion = CommandedMotion.of(Odometry(np.zeros(1), np.array([0.5]), np.array([0.25])), 100.0)
    pose, _ = motion.at(np.array([2.0, 10.0]), 1.2, 0.8, 0.5)
    w, v = 0.8 * 0.25, 1.2 * 0.5
    turned = w * np.array([1.5, 9.5])
    np.testing.assert_allclose(pose[:, 2], turned, atol=1e-12)
    np.testing.assert_allclose(pose[:, 0], v / w * np.sin(turned), atol=1e-12)
    np.testing.assert_allclose(pose[:, 1], v / w * (1 - np.cos(turned)), atol=1e-12)


def test_derivatives_by_the_calibration_are_those_of_differences(motion):
    t = motion.t[0] + np.array([0.013, 0.5, 1.77, 3.21, 4.9])
    at = np.array([1.1, 0.9, 0.117])
    step = motion.between(t, *at)
    for k, h in enumerate((1e-6, 1e-6, 1e-7)):
        d = np.zeros(3)
        d[k] = h
        change = (motion.between(t, *(at + d)).step - motion.between(t, *(at - d)).step) / (2 * h)
        np.testing.assert_allclose(step.by_calibration[:, :, k], change, atol=2e-6)


def test_steps_put_together_are_the_whole_way(motion):
    t = np.linspace(motion.t[0], motion.t[-1], 17)
    pose, _ = motion.at(t, 1.0, 0.95, 0.2)
    whole = pose[0]
    for step in motion.between(t, 1.0, 0.95, 0.2).step:
        whole = se2.compose(whole, step)
    np.testing.assert_allclose(whole[:2], pose[-1, :2], atol=1e-12)


def test_commands_stop_counting_when_none_come_and_the_noise_grows_instead():
    motion = CommandedMotion.of(Odometry(np.array([0.0, 20.0]), np.array([1.0, 1.0]), np.zeros(2)), 2.0)
    pose, _ = motion.at(np.array([2.0, 19.0]), 1.0, 1.0, 0.0)
    np.testing.assert_allclose(pose[:, 0], 2.0)
    cfg = MotionNoise()
    known, lost = motion.noise(np.array([0.0, 2.0, 19.0]), 0.0, cfg)
    assert lost[0, 0] == pytest.approx(MOTION_REST_XY**2 * 17 + MOTION_LOST_XY**2 * 17)
    assert known[0, 0] == pytest.approx(cfg.along**2 * 2 + MOTION_REST_XY**2 * 2)


def test_every_covariance_of_a_step_is_positive_definite(motion):
    t = np.linspace(motion.t[0] - 1.0, motion.t[-1] + 5.0, 40)
    for Q in (motion.noise(t, 0.15, MotionNoise()), random_walk(t)):
        assert np.linalg.eigvalsh(Q).min() > 0
