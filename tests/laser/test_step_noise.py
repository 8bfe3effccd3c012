"""How far a step errs: wheels and walls are independent witnesses, and errors grow with the way."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.laser.keyframes import (
    STEP_NOISE_BLUR,
    STEP_NOISE_HOLD,
    STEP_NOISE_TRUST,
    KeyframeConfig,
    KeyframeMaker,
    StepNoise,
    believed,
    step_covariance,
    wheel_noise,
)
from mapweave.mapping.graph_slam import GONE

NOISE = StepNoise()


def test_squares_of_odometry_grow_with_the_way_and_with_the_turning_either_way_round():
    base = wheel_noise(np.zeros(3), NOISE)
    assert np.linalg.eigvalsh(base)[0] > 0
    assert base.max() < 1e-7

    def more(*step):
        return wheel_noise(np.array(step), NOISE) - base

    ahead, spun = more(1.0, 0.0, 0.0), more(0.0, 0.0, 1.0)
    np.testing.assert_allclose(
        ahead, np.diag([NOISE.wheels_xy**2, NOISE.wheels_xy**2, NOISE.wheels_turn_per_m**2]), rtol=1e-6
    )
    np.testing.assert_allclose(spun, np.diag([0.0, 0.0, NOISE.wheels_turn**2]), rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(more(3.0, -4.0, -2.0), 5.0 * ahead + 2.0 * spun, rtol=1e-6)


@pytest.mark.parametrize("way", [0.0, 2.5])
def test_what_walls_and_wheels_tell_adds_up_and_drift_comes_on_top(way):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3)) * 50.0
    lines, wheels = root @ root.T, wheel_noise(np.array([0.8, 0.1, 0.3]), NOISE)
    cov = step_covariance(lines, wheels, way, NOISE)
    told = believed(lines, STEP_NOISE_TRUST, STEP_NOISE_BLUR)[:2, :2]
    place = np.linalg.inv(told + np.linalg.inv(wheels[:2, :2])) + NOISE.drift_xy**2 * way * np.eye(2)
    np.testing.assert_allclose(cov[:2, :2], place, atol=2e-8)
    heading = 1.0 / (STEP_NOISE_HOLD * lines[2, 2] + 1.0 / wheels[2, 2]) + NOISE.drift_turn**2 * way
    assert cov[2, 2] == pytest.approx(heading, rel=1e-3, abs=2e-10)
    assert not cov[2, :2].any()
    assert not cov[:2, 2].any()


def test_without_walls_a_step_errs_as_the_wheels_do_and_without_wheels_as_the_walls_do():
    wheels = wheel_noise(np.array([1.0, 0.0, 0.5]), NOISE)
    np.testing.assert_allclose(step_covariance(np.zeros((3, 3)), wheels, 0.0, NOISE), wheels, rtol=1e-3, atol=2e-8)
    lines = np.diag([4e4, 1e4, 2e4])
    blind = np.diag([1e6, 1e6, 1e6])
    sure = believed(lines, STEP_NOISE_TRUST, STEP_NOISE_BLUR)
    np.testing.assert_allclose(
        step_covariance(lines, blind, 0.0, NOISE)[:2, :2], np.linalg.inv(sure[:2, :2]), rtol=1e-2, atol=2e-8
    )


def test_a_step_that_everything_is_sure_of_keeps_a_covariance_that_can_be_inverted():
    sure = step_covariance(1e12 * np.eye(3), np.zeros((3, 3)), 0.0, NOISE)
    assert np.linalg.eigvalsh(sure)[0] > 1e-11


def test_a_keyframes_step_drifts_with_the_way_since_the_last_one():
    maker, step, lines = KeyframeMaker(0, KeyframeConfig(distance=1.0)), np.array([0.3, 0.4, 0.0]), 1e6 * np.eye(3)
    keyframes = [maker.keyframe(0.0, GONE)]
    for k in range(1, 7):
        maker.advance(k * step, step, lines)
        keyframes.append(maker.keyframe(float(k), GONE))
    first, second, third, fourth = (k for k in keyframes if k is not None)
    assert [second.path, third.path, fourth.path] == pytest.approx([1.0, 2.0, 3.0])
    np.testing.assert_allclose(third.cov, second.cov, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(fourth.cov, second.cov, rtol=1e-6, atol=1e-12)
    assert not first.cov.any()
    still = step_covariance(lines, 2 * wheel_noise(step, NOISE), 0.0, NOISE)
    assert second.cov[2, 2] - still[2, 2] == pytest.approx(NOISE.drift_turn**2, rel=0.05)


def test_a_keyframe_has_the_way_that_wheels_told_since_the_last_one_where_they_told_all_of_it():
    maker, lines = KeyframeMaker(0, KeyframeConfig(distance=0.9)), 1e4 * np.eye(3)
    maker.keyframe(0.0, GONE)
    turned, ahead = np.array([0.5, 0.0, 0.3]), np.array([0.4, 0.1, 0.0])
    made = []
    for k, wheels in enumerate([turned, ahead, ahead, None, turned, ahead], 1):
        maker.advance(np.array([0.5 * k, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]), lines, wheels)
        made.append(maker.keyframe(float(k), GONE))
    first, second, third = (k for k in made if k is not None)
    np.testing.assert_allclose(first.wheels, se2.compose(turned, ahead))
    assert second.wheels is None
    np.testing.assert_allclose(third.wheels, se2.compose(turned, ahead))


def test_keyframes_are_counted_and_their_steps_lead_from_each_to_the_next():
    rng = np.random.default_rng(2)
    cfg = KeyframeConfig(distance=0.9, turn=0.45)
    maker, pose, path, made = KeyframeMaker(3, cfg), np.array([1.0, -2.0, 0.5]), 0.0, []
    maker.advance(pose, np.zeros(3), np.zeros((3, 3)))
    for k in range(60):
        before = made[-1].local if made else None
        new = maker.keyframe(float(k), GONE)
        far = before is None or np.hypot(*(pose - before)[:2]) >= 0.9 or abs(se2.wrap_angle(pose - before)[2]) >= 0.45
        assert (new is not None) == far
        if new is not None:
            assert (new.robot, new.number, new.t) == (3, len(made), float(k))
            assert new.path == pytest.approx(path)
            np.testing.assert_array_equal(new.local, pose)
            if before is not None:
                np.testing.assert_allclose(se2.compose(before, new.step), pose, atol=1e-12)
            assert maker.last is new
            made.append(new)
        step = np.array([*rng.uniform(-0.2, 0.4, 2), rng.uniform(-0.4, 0.4)])
        pose = se2.compose(pose, step)
        path += np.hypot(*step[:2])
        maker.advance(pose, step, 1e4 * np.eye(3))
    turned = sum(np.hypot(*k.step[:2]) < 0.9 for k in made[1:])
    assert 3 < turned < len(made) - 4
