"""Where a robot looked, read off its own log, and how surely what stands there is in its map."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import NOTHING_SEEN, SightingTable
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import EVERY, LOOKS, SUREST, View, view_of

AHEAD = View(reach=2.0, right=-0.5, left=0.5, rate=0.5)


def standing(seconds, heading=0.0):
    t = np.arange(0.0, seconds, 0.1)
    return Track(t, np.tile([1.0, 1.0, heading], (len(t), 1)))


def test_what_was_in_view_often_is_in_the_map_and_what_was_never_in_view_is_not():
    points = np.array([[2.0, 1.0], [4.0, 1.0], [1.0, 2.0], [0.0, 1.0]])  # ahead, too far, to the left, behind
    for looks, want in ((1, 0.5), (2, 0.75), (40, 1.0)):
        got = AHEAD.mapped(standing(looks * EVERY), points)
        np.testing.assert_allclose(got, [SUREST * want, 0.0, 0.0, 0.0], atol=1e-9)
    turned = AHEAD.mapped(standing(2.0, np.pi / 2), points)
    np.testing.assert_allclose(turned, [0.0, 0.0, SUREST * 0.75, 0.0], atol=1e-9)


def test_a_long_log_is_looked_through_in_no_more_looks_than_are_allowed():
    t = np.arange(0.0, 3 * LOOKS, 0.5)
    assert len(AHEAD.looks(Track(t, np.zeros((len(t), 3))), np.zeros((1, 2)))) <= LOOKS + 1
    assert AHEAD.looks(standing(3.0), np.zeros((0, 2))).shape == (3, 0)


def test_stamps_of_any_clock_and_length_give_looks_at_poses_that_there_are():
    for start in (0.0, 1.7e9, 1.7e18):
        for seconds in (0.1, 3.0, 7.3, 2001.7):
            t = np.unique(start + np.arange(0.0, seconds, 0.1))
            looks = AHEAD.looks(Track(t, np.zeros((len(t), 3))), np.zeros((1, 2)))
            assert 1 <= len(looks) <= len(t)


@pytest.mark.parametrize("turn", [0.0, 1.5, np.pi, -2.7])
def test_a_view_is_read_off_what_was_sighted_and_how_often_wherever_the_sensor_looks(turn):
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 400.0)
    track = Track(t, np.stack([4 * np.sin(0.05 * t), 4 * np.cos(0.05 * t), 0.3 * t - turn], axis=-1))
    places = rng.uniform(-6, 6, (30, 2))
    true = View(3.0, turn - 0.6, turn + 0.4, 0.7)
    look, what = np.nonzero((true.looks(track, places) > 0) & (rng.random((400, 30)) < true.rate))
    off = places[what] - track.pose[look, :2]
    bearing = np.arctan2(off[:, 1], off[:, 0]) - track.pose[look, 2]
    ids = tuple(map(str, range(30)))
    table = SightingTable(t[look], what, np.hypot(*off.T), np.arctan2(np.sin(bearing), np.cos(bearing)), ids)
    view = view_of(track, table, ids, places)
    assert view is not None
    assert view.reach == pytest.approx(true.reach, abs=0.15)
    assert se2.wrap_angle(np.array([view.right, view.left]) - turn) == pytest.approx([-0.55, 0.35], abs=0.05)
    assert view.rate == pytest.approx(true.rate, abs=0.05)
    assert view_of(track, table, ids[:0], places[:0]) is None


def test_who_sighted_nothing_or_never_moved_in_time_tells_no_view():
    assert view_of(standing(5.0), NOTHING_SEEN, (), np.zeros((0, 2))) is None
    one = SightingTable(np.zeros(1), np.zeros(1, int), np.ones(1), np.zeros(1), ("a",))
    assert view_of(Track(np.zeros(1), np.zeros((1, 3))), one, ("a",), np.array([[1.0, 0.0]])) is None
