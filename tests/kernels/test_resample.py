"""Systematic resampling against its definition: one draw, evenly spaced from there."""

import numpy as np
import pytest

from mapweave.kernels.laser.refine import systematic

pytestmark = pytest.mark.kernel


def by_definition(w, u):
    """How often each particle is hit by the points (k + u) / n in the cumulated shares."""
    points = (np.arange(len(w)) + u) / len(w)
    return np.bincount(np.searchsorted(np.cumsum(w) / w.sum(), points, side="right"), minlength=len(w))


def test_counts_are_those_of_evenly_spaced_points_from_the_draw_on():
    rng = np.random.default_rng(3)
    differ = 0
    for _ in range(30):
        w = rng.random(13) ** 3
        u = rng.random()
        count = np.bincount(systematic(w, u), minlength=13)
        assert np.array_equal(count, by_definition(w, u))
        differ += not np.array_equal(count, by_definition(w, 0.0))
    assert differ > 10


def test_over_all_draws_a_particle_has_as_many_children_as_its_share():
    w = np.array([0.05, 0.5, 0.15, 0.3])
    draws = (np.arange(1000) + 0.5) / 1000
    count = sum(np.bincount(systematic(w, u), minlength=4) for u in draws)
    np.testing.assert_allclose(count / 1000, 4 * w, atol=2e-3)


@pytest.mark.parametrize("dead", [0, 1, 3])
def test_what_rounding_leaves_undrawn_falls_to_the_last_particle_that_has_any_weight(dead):
    w = np.concatenate([np.random.default_rng(4).random(5) + 0.1, np.zeros(dead)])
    last = np.nextafter(1.0, 0.0)  # so late a draw that the last point lies at the sum itself
    ancestors = systematic(w, last)
    count = np.bincount(ancestors, minlength=len(w))
    assert count.sum() == len(w)
    assert not count[5:].any()
    np.testing.assert_array_equal(count, np.bincount(systematic(w, 1.0 - 1e-9), minlength=len(w)))
    assert all(ancestors[k] == k for k in np.flatnonzero(count))
