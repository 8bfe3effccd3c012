"""The simulated swarm is what was asked for, and what is written reads back."""

import numpy as np
import pytest

from mapweave.core.errors import UsageError
from mapweave.io.sightings import read_sightings, write_sightings
from mapweave.sim.swarm import SwarmScene, simulate_swarm


def made(seed=0, **more):
    return simulate_swarm(SwarmScene(**more), np.random.default_rng(seed))


def errors(swarm):
    """Angles [rad] between sighted and true directions, in common axes."""
    table = swarm.table
    d = swarm.position[0][table.target] - swarm.position[0][table.observer]
    u = d / np.linalg.norm(d, axis=1, keepdims=True)
    return np.arccos(np.clip(np.sum(u * table.direction, axis=1), -1.0, 1.0))


@pytest.mark.parametrize("dim", [2, 3])
def test_every_robot_sees_its_eight_nearest_with_the_noise_asked_for(dim):
    swarm = made(robots=1000, dim=dim, sigma=0.01)
    assert np.all(np.bincount(swarm.table.observer) == 8)
    # In space the angle has two Gaussian components across the ray.
    assert np.sqrt(np.mean(errors(swarm) ** 2)) == pytest.approx(0.01 * np.sqrt(dim - 1), rel=0.03)


def test_the_grid_has_cells_of_ten_metres_jittered_by_three():
    swarm = made(robots=100)
    cell = np.round(swarm.position[0] / 10.0)
    assert np.abs(swarm.position[0] - 10.0 * cell).max() <= 3.0
    assert len(np.unique(cell, axis=0)) == 100


def test_corner_robots_are_four_in_the_plane_and_eight_in_space():
    assert made(robots=100).corners == (0, 9, 90, 99)
    assert len(made(robots=125, dim=3).corners) == 8


@pytest.mark.parametrize("visibility", ["mutual", "single"])
def test_mutual_pairs_see_each_other_and_single_pairs_do_not(visibility):
    table = made(robots=60, visibility=visibility).table
    pairs = set(zip(table.observer.tolist(), table.target.tolist(), strict=True))
    both = {(a, b) for a, b in pairs if (b, a) in pairs}
    assert len(pairs) == len(table.observer)
    assert both == (pairs if visibility == "mutual" else set())


def test_the_two_directions_of_a_pair_have_noise_of_their_own():
    table = made(robots=60, visibility="mutual", sigma=0.02).table
    angle = dict(zip(zip(table.observer.tolist(), table.target.tolist(), strict=True), table.bearing(), strict=True))
    gap = np.array([(angle[a, b] - angle[b, a] - np.pi + np.pi) % (2 * np.pi) - np.pi for a, b in angle])
    assert np.sqrt(np.mean(gap**2)) == pytest.approx(0.02 * np.sqrt(2), rel=0.15)


def test_range_limits_who_is_seen():
    swarm = made(robots=60, range=14.0)
    d = swarm.position[0][swarm.table.target] - swarm.position[0][swarm.table.observer]
    assert np.linalg.norm(d, axis=1).max() <= 14.0


def test_missing_and_outlying_sightings_come_in_their_shares():
    whole, part = made(robots=1000), made(robots=1000, missing=0.4, outliers=0.1, sigma=0.001)
    assert len(part.table.observer) / len(whole.table.observer) == pytest.approx(0.6, abs=0.02)
    assert np.mean(errors(part) > 0.02) == pytest.approx(0.1, abs=0.02)


def test_objects_in_the_way_hide_some_sightings_and_keep_the_rest_as_they_are():
    clear, hidden = made(robots=200), made(robots=200, blockers=10)
    assert 0.5 < len(hidden.table.observer) / len(clear.table.observer) < 0.98


def test_without_a_common_axis_every_robot_has_a_heading_of_its_own():
    swarm = made(robots=50, axis=False, sigma=1e-6)
    turned = swarm.table.bearing() + swarm.heading[0][swarm.table.observer]
    d = swarm.position[0][swarm.table.target] - swarm.position[0][swarm.table.observer]
    assert np.allclose(np.cos(turned), d[:, 0] / np.linalg.norm(d, axis=1), atol=1e-4)
    assert np.std(swarm.heading[0]) > 1.0


def test_moving_robots_are_stamped_and_the_corner_ones_stand_still():
    swarm = made(robots=25, steps=20)
    assert np.array_equal(np.unique(swarm.table.t), np.arange(20.0))
    moved = np.linalg.norm(swarm.position[-1] - swarm.position[0], axis=1)
    assert np.all(moved[list(swarm.corners)] == 0.0)
    assert np.median(moved) > 1.0


def test_driving_robots_follow_their_odometry():
    swarm = made(robots=9, steps=30, drive=True, interval=0.5)
    v, w = np.moveaxis(swarm.odometry, -1, 0)
    turned = np.sum(w[:-1] * 0.5, axis=0)
    assert np.allclose(turned, swarm.heading[-1] - swarm.heading[0], atol=0.5)
    way = np.sum(np.linalg.norm(np.diff(swarm.position, axis=0), axis=2), axis=0)
    assert np.allclose(np.sum(v[:-1] * 0.5, axis=0), way, atol=0.5)


def test_the_same_seed_gives_the_same_swarm_and_another_seed_another():
    assert np.array_equal(made(seed=3).table.direction, made(seed=3).table.direction)
    assert not np.array_equal(made(seed=3).table.direction, made(seed=4).table.direction)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("more", [{"dim": 2}, {"dim": 3}, {"dim": 2, "steps": 3}])
def test_a_written_swarm_reads_back(tmp_path, suffix, more):
    table = made(robots=30, **more).table
    path = tmp_path / f"s.{suffix}"
    write_sightings(path, table)
    again = read_sightings(path).table
    assert again.ids == table.ids
    assert np.array_equal(again.observer, table.observer)
    assert np.array_equal(again.target, table.target)
    assert np.allclose(again.direction, table.direction, atol=1e-8)
    assert np.allclose(again.sigma, table.sigma)
    assert (again.t is None) == (table.t is None)


@pytest.mark.parametrize("more", [{"robots": 1}, {"missing": 1.5}, {"outliers": -0.1}, {"k": 0}, {"steps": 0}])
def test_a_scene_that_cannot_be_is_a_usage_error(more):
    with pytest.raises(UsageError):
        made(**more)
