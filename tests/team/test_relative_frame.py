"""Frames tied by what robots of the one saw of the other: ranges or bearings, either way, some of it wrong."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.team.config import PlacingConfig
from mapweave.team.relation import PLACING_LEAST, MutualSightings, is_sure, point_seen, relate, residuals

CFG = PlacingConfig()


def made(seed, m=40, *, ranges=True, wrong=0.0, noise=0.02):
    """Sightings between a and b, which lies at T in a."""
    rng = np.random.default_rng(seed)
    T = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi)])
    forward = rng.random(m) < 0.5
    pose = np.column_stack([rng.uniform(-4, 4, (m, 2)), rng.uniform(-np.pi, np.pi, m)])
    point = rng.uniform(-4, 4, (m, 2))
    d = point - pose[:, :2]
    r = np.hypot(*d.T) * (1 + noise * rng.standard_normal(m))
    b = np.arctan2(d[:, 1], d[:, 0]) - pose[:, 2] + noise * rng.standard_normal(m)
    lost = rng.random(m) < wrong
    b = np.where(lost, rng.uniform(-np.pi, np.pi, m), b)
    r = np.where(lost, r + rng.uniform(1, 4, m), r)
    back = se2.inverse(T)
    in_b = se2.compose(back, pose), se2.act(back, point)
    z = MutualSightings(
        forward,
        np.where(forward[:, None], pose, in_b[0]),
        np.where(forward[:, None], in_b[1], point),
        r if ranges else np.full(m, np.nan),
        b,
        np.arange(m, dtype=float),
    )
    return z, T


@pytest.mark.parametrize("ranges", [True, False])
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_a_frame_is_found_whatever_the_heading(ranges, wrong):
    for seed in range(12):
        z, T = made(seed, ranges=ranges, wrong=wrong)
        found = relate(z, CFG)
        assert is_sure(found, CFG)
        e = found.transform - T
        e[2] = se2.wrap_angle(e[2])
        assert np.abs(e).max() < 0.2
        assert found.agree >= (1 - wrong - 0.2) * len(z)


def test_what_is_true_has_no_residual():
    z, T = made(3, noise=0.0)
    np.testing.assert_allclose(residuals(z, T, CFG), 0.0, atol=1e-9)
    several = np.stack([T, T + np.array([1.0, 0.0, 0.0])])
    assert residuals(z, several, CFG).shape == (2, len(z), 2)
    assert np.abs(residuals(z, several, CFG)[1]).max() > 1


def test_seen_the_other_way_round_is_the_inverse():
    z, T = made(5, noise=0.0)
    turned = MutualSightings(~z.forward, z.pose, z.point, z.range, z.bearing, z.t)
    np.testing.assert_allclose(relate(turned, CFG).transform, se2.inverse(T), atol=1e-5)


def test_too_little_or_contradicting_sightings_tell_nothing():
    z, _ = made(7)
    assert relate(z.select(np.arange(PLACING_LEAST - 1)), CFG) is None
    rng = np.random.default_rng(1)
    noise = MutualSightings(z.forward, z.pose, z.point, z.range, rng.uniform(-np.pi, np.pi, len(z)), z.t)
    assert relate(noise, CFG) is None


def test_bearings_of_one_standing_robot_from_one_place_leave_its_distance_open():
    m = 20
    z = MutualSightings(
        np.ones(m, bool), np.zeros((m, 3)), np.zeros((m, 2)), np.full(m, np.nan), np.full(m, 0.3), np.arange(m) * 1.0
    )
    assert not is_sure(relate(z, CFG), CFG)


@pytest.mark.parametrize("bearing", [1e-4, 1e-6])
def test_sightings_of_one_point_by_a_sensor_told_to_be_sharp_leave_the_turn_open(bearing):
    cfg = replace(CFG, bearing=bearing)
    for seed in range(15):
        z, _ = made(seed, 6, wrong=0.3)
        z = MutualSightings(np.ones(6, bool), z.pose, np.tile(z.point[:1], (6, 1)), z.range, z.bearing, z.t)
        assert not is_sure(relate(z, cfg), cfg)


def test_a_point_is_where_its_bearings_meet():
    rng = np.random.default_rng(2)
    pose = np.column_stack([rng.uniform(-3, 3, (20, 2)), rng.uniform(-np.pi, np.pi, 20)])
    d = np.array([1.0, 2.0]) - pose[:, :2]
    b = np.arctan2(d[:, 1], d[:, 0]) - pose[:, 2]
    b[:4] += 1.5
    z = MutualSightings(np.ones(20, bool), pose, np.zeros((20, 2)), np.full(20, np.nan), b, np.arange(20.0))
    np.testing.assert_allclose(point_seen(z, CFG), [1.0, 2.0], atol=0.05)
    still = MutualSightings(z.forward, np.tile(pose[5], (20, 1)), z.point, z.range, np.full(20, b[5]), z.t)
    assert point_seen(still, CFG) is None


def test_a_place_at_a_point_that_was_sighted_is_no_sure_one_and_no_failure():
    m = 17
    way = np.linspace(0.0, 1.0, m)
    pose = np.column_stack([3.0 + 0.3 * way, 0.9 * way, np.full(m, 1.2)])
    point = np.column_stack([np.full(m, -1.7), 1.3 - way])
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wrong = np.where(rng.random(m) < 0.2, rng.uniform(-1, 3, m), 0.0)
        bearing = -0.4 - 0.15 * way + 0.005 * rng.standard_normal(m) + wrong
        z = MutualSightings(np.zeros(m, bool), pose, point, np.full(m, np.nan), bearing, np.arange(m, dtype=float))
        found = relate(z, CFG)
        assert found is None or np.sqrt(np.diag(found.cov)[:2].max()) > 0.01
