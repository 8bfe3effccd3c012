"""Numbers of a sensor as bytes: the same again to the bit, short, and nothing else taken for them."""

import zlib

import numpy as np
import pytest

from mapweave.live.messages import KEPT_LONGEST, RefusedError, squeeze, stretch

rng = np.random.default_rng(0)
MILLIMETRES = np.rint(1000 * (3.0 + 0.2 * rng.standard_normal(300)).cumsum() / np.arange(1, 301))


@pytest.mark.parametrize(
    ("values", "kinds"),
    [
        (np.array([1.234, -5.0, 0.0]), "mM"),
        (np.array([3.0, 70.0, -2.0]), "iI"),
        (MILLIMETRES / 1000, "M"),
        (np.float32(MILLIMETRES / 1000).astype(float), "S"),
        (np.float32([1 / 3, -2 / 3, 1e-30, -1e30, 0.0]).astype(float), "fF"),
        (np.array([1 / 3, 2.0]), "d"),
        (np.array([-0.0, 0.0]), "fF"),
        (np.array([1e12, 0.001]), "d"),
        (np.array([1e300, 0.001]), "d"),
        (np.array([2.0**31 - 1, 1.0 - 2.0**31]), "i"),
        (np.zeros(0), "iI"),
    ],
)
def test_numbers_come_back_to_the_bit_told_in_the_shortest_way(values, kinds):
    data = squeeze(values)
    assert data[:1].decode() in kinds
    assert stretch(data, len(values)).tobytes() == values.tobytes()


def test_any_bits_of_single_numbers_come_back():
    bits = rng.integers(0, 2**32, 5000, dtype=np.uint32).view(np.float32)
    values = bits[np.isfinite(bits)].astype(float)
    assert stretch(squeeze(values), len(values)).tobytes() == values.tobytes()


def test_ranges_in_millimetres_take_less_than_half_of_packed_float32():
    values = np.float32(MILLIMETRES / 1000)
    assert 2 * len(squeeze(values.astype(float))) < len(zlib.compress(values.tobytes(), 6))


ONES = squeeze(np.ones(3))


@pytest.mark.parametrize(
    ("data", "n"),
    [
        (b"", 1),
        (b"x123", 1),
        (b"D" + zlib.compress(b"\0" * 8), 1),
        (b"\xff123", 1),
        (b"dnothing packed", 1),
        (ONES, 4),
        (ONES, 2),
        (squeeze(np.zeros(1_000_000)), 10),
        (squeeze(np.array([np.inf])), 1),
        (squeeze(np.array([np.nan])), 1),
        (b"I" + zlib.compress(b"\xfe" * 8 + b"\xff" * 24), 8),
        (ONES[:-4], 3),
    ],
)
def test_columns_that_are_not_what_they_say_are_refused(data, n):
    with pytest.raises(RefusedError, match="malformed"):
        stretch(data, n)


@pytest.mark.parametrize("n", [KEPT_LONGEST, KEPT_LONGEST + 1])
def test_a_column_that_is_asked_for_again_is_the_same_and_cannot_be_changed(n):
    values = np.arange(n) / 1000.0
    data = squeeze(values)
    once, again = stretch(data, n), stretch(bytes(bytearray(data)), n)
    assert (once is again) == (n <= KEPT_LONGEST)
    assert once.tobytes() == again.tobytes() == values.tobytes()
    assert not once.flags.writeable
    with pytest.raises(RefusedError):
        stretch(data, n - 1)
