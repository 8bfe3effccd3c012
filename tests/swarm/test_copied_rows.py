"""Rows that repeat others to the bit count once; readings that rounding made equal count each."""

import numpy as np
import pytest

from mapweave import locate
from mapweave.core.bearings import BearingTable, unit
from mapweave.swarm.network import copies

SIGMA = np.radians(1.0)
TRUTH = np.array([[0.0, 0.0], [10.0, 0.0], [4.0, 7.0], [12.0, 9.0], [5.0, -6.0]])
IDS = tuple("abcde")


def readings(times, step=0.0, seed=0, stamped=False):
    """Everybody sees everybody `times` times, rounded to `step` [rad]."""
    i, j = np.nonzero(~np.eye(5, dtype=bool))
    i, j = np.tile(i, times), np.tile(j, times)
    d = TRUTH[j] - TRUTH[i]
    z = np.arctan2(d[:, 1], d[:, 0]) + np.random.default_rng(seed).normal(0, SIGMA, len(i))
    z = np.round(z / step) * step if step else z
    t = np.repeat(np.arange(float(times)), len(i) // times) if stamped else None
    return BearingTable(IDS, i, j, unit(z), np.full(len(i), SIGMA), t)


def found(table):
    return copies(table, table.sigma)


@pytest.mark.parametrize("times", [1, 2, 10])
@pytest.mark.parametrize("stamped", [False, True])
def test_every_row_of_a_block_that_comes_again_is_a_copy_and_none_of_the_block(times, stamped):
    table = readings(times, stamped=stamped)
    m = len(table.observer)
    assert not found(table).any()
    assert found(table.rows(np.tile(np.arange(m), 4))).tolist() == [False] * m + [True] * (3 * m)


@pytest.mark.parametrize("degrees", [0.1, 0.5, 1.0])
def test_readings_that_rounding_made_equal_are_no_copies(degrees):
    table = readings(20, step=np.radians(degrees))
    assert len(np.unique(table.direction, axis=0)) < 0.9 * len(table.direction)
    assert not found(table).any()


def test_equal_readings_of_other_moments_are_no_copies_and_of_one_moment_they_are():
    table = readings(2, stamped=True)
    m = len(table.observer) // 2
    again = np.concatenate([np.arange(m), np.arange(m)])
    later = BearingTable(
        IDS, *(getattr(table, k)[again] for k in ("observer", "target", "direction", "sigma")), table.t
    )
    assert not found(later).any()
    assert found(table.rows(again)).sum() == m


def test_a_reading_of_another_robot_another_direction_or_another_sigma_is_no_copy():
    z, sigma = unit(np.array([0.3, 0.3, 0.30001, 0.3])), np.array([SIGMA, SIGMA, SIGMA, 2 * SIGMA])
    table = BearingTable(IDS, np.zeros(4, int), np.array([1, 2, 1, 1]), z, sigma)
    assert not found(table).any()


def test_a_table_four_times_over_is_the_table_once_and_says_so():
    once = readings(1)
    given = {"observer": [IDS[k] for k in once.observer], "target": [IDS[k] for k in once.target]}
    given["bearing"] = once.bearing()
    anchors = {"a": TRUTH[0], "b": TRUTH[1]}
    one = locate(given, anchors=anchors, sigma="1deg")
    four = locate({k: [*v] * 4 for k, v in given.items()}, anchors=anchors, sigma="1deg")
    np.testing.assert_array_equal(one.estimate.cov, four.estimate.cov)
    assert any("60 rows are copies of other rows" in w for w in four.given.warnings)
    assert [d.reason for d in four.given.dropped] == ["copy of another row"] * 60
    assert not one.given.dropped
