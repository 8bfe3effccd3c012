"""Sightings that contradict each other are told from those that noise explains; foreign axes are noticed."""

import numpy as np
import pytest

from mapweave.core.bearings import BearingTable, unit, unit3
from mapweave.swarm.network import contradictions, shares_an_axis

SIGMA = 0.01  # [rad]
APART = 6.0 * np.sqrt(2.0) * SIGMA  # six standard deviations of the difference of two sightings


def table(observer, target, direction, t=None):
    robots = int(max(np.max(observer), np.max(target))) + 1
    ids = tuple(f"r{k}" for k in range(robots))
    stamps = None if t is None else np.asarray(t, float)
    return BearingTable(ids, np.array(observer), np.array(target), direction, np.full(len(observer), np.nan), stamps)


def found(rows):
    return contradictions(rows, np.full(len(rows.observer), SIGMA)).tolist()


@pytest.mark.parametrize("start", [0.4, np.pi - 0.01])
def test_two_sightings_of_one_robot_contradict_beyond_six_standard_deviations_of_their_difference(start):
    def two(apart):
        return table([0, 0], [1, 1], unit(np.array([start, start + apart])))

    assert found(two(0.97 * APART)) == [False, False]
    assert found(two(1.03 * APART)) == [True, True]


def test_the_gate_is_as_wide_in_space():
    def two(apart):
        return table([0, 0], [1, 1], unit3(np.full(2, 0.7), np.array([0.2, 0.2 + apart])))

    assert found(two(0.97 * APART)) == [False, False]
    assert found(two(1.03 * APART)) == [True, True]


def test_the_less_sure_of_two_sightings_does_not_save_the_surer_one():
    rows = table([0, 0], [1, 1], unit(np.array([0.0, 1.03 * APART])))
    assert contradictions(rows, np.array([SIGMA, 5 * SIGMA])).tolist() == [True, True]
    assert contradictions(rows, np.array([2 * SIGMA, 2 * SIGMA])).tolist() == [False, False]


def test_of_three_sightings_the_odd_one_alone_is_doubted():
    rows = table([0, 0, 0], [1, 1, 1], unit(np.array([1.0, 1.0 + 2 * APART, 1.0 + 0.2 * SIGMA])))
    assert found(rows) == [False, True, False]


def test_other_pairs_other_directions_and_other_stamps_contradict_nothing():
    angle = unit(np.array([0.0, 2.0]))
    assert found(table([0, 0], [1, 2], angle)) == [False, False]
    assert found(table([0, 1], [1, 0], angle)) == [False, False]
    assert found(table([0, 0], [1, 1], angle, [3.0, 4.0])) == [False, False]
    assert found(table([0, 0], [1, 1], angle, [3.0, 3.0])) == [True, True]


def test_rows_are_named_in_the_order_they_came():
    rows = table([2, 0, 1, 0, 2], [0, 1, 2, 1, 0], unit(np.array([0.5, 0.0, 1.0, 1.0, 0.5])))
    assert found(rows) == [False, True, False, True, False]


def mutual(pairs, off):
    """Pairs of robots that see each other; the second's sighting is `off` [rad] from opposite."""
    k = np.arange(pairs)
    angle = np.linspace(0.0, 3.0, pairs)
    both = unit(np.concatenate([angle, angle + np.pi + off]))
    return table(np.concatenate([2 * k, 2 * k + 1]), np.concatenate([2 * k + 1, 2 * k]), both)


def test_an_axis_is_shared_until_half_of_the_mutual_sightings_are_plainly_not_opposite():
    sigma = np.full(12, SIGMA)
    assert shares_an_axis(mutual(6, 0.48), sigma)
    assert not shares_an_axis(mutual(6, 0.52), sigma)
    assert shares_an_axis(mutual(6, 0.98), 5 * sigma)  # 20 sigma are 1.0 rad
    assert not shares_an_axis(mutual(6, 1.02), 5 * sigma)


def test_fewer_than_five_mutual_pairs_say_nothing_of_axes():
    assert shares_an_axis(mutual(4, 2.0), np.full(8, SIGMA))
    assert not shares_an_axis(mutual(5, 2.0), np.full(10, SIGMA))
