"""Rows kept in one array, and those that stand for all."""

import numpy as np
import pytest

from mapweave.core.rows import RowBuffer, spread


@pytest.mark.parametrize("shape", [(), (3,), (3, 3)])
def test_rows_are_those_that_were_appended(shape):
    rng = np.random.default_rng(0)
    given, rows = rng.normal(size=(1000, *shape)), RowBuffer(*shape)
    for row in given:
        rows.append(row)
    assert len(rows) == 1000
    assert np.array_equal(rows.array, given)
    assert np.array_equal(np.array(list(rows)), given)
    assert np.array_equal(rows[-1], given[-1])
    assert np.array_equal(rows[7], given[7])


def test_what_was_handed_out_stays_as_it_was():
    rows = RowBuffer(2)
    rows.append([1.0, 2.0])
    first, whole = rows[0], rows.array
    rows.clear()
    rows.append([3.0, 4.0])
    assert first.tolist() == [1.0, 2.0]
    assert whole.tolist() == [[1.0, 2.0]]
    assert rows.array.tolist() == [[3.0, 4.0]]


def test_a_row_that_is_not_there_is_an_error():
    rows = RowBuffer()
    rows.append(1.0)
    with pytest.raises(IndexError):
        rows[1]


@pytest.mark.parametrize("count", [0, 1, 100])
def test_only_the_newest_row_is_kept(count):
    rows = RowBuffer(2)
    for k in range(count):
        rows.append([k, -k])
    rows.keep_last()
    assert rows.array.tolist() == [[k, -k] for k in range(count)][-1:]
    rows.append([7.0, 8.0])
    assert rows[-1].tolist() == [7.0, 8.0]
    assert len(rows) == min(count, 1) + 1


@pytest.mark.parametrize("n", [0, 1, 2, 7, 50])
@pytest.mark.parametrize("most", [1, 2, 7, 12, 50, 60])
def test_rows_that_stand_for_all_are_as_many_as_asked_for_each_once_and_evenly_apart(n, most):
    rows = spread(n, most)
    assert len(rows) == min(n, most)
    assert len(np.unique(rows)) == len(rows)
    if n:
        assert rows[0] == 0
    if len(rows) > 1:
        assert rows[-1] == n - 1
        assert np.ptp(np.diff(rows)) <= 1
