"""How far another's clock is ahead, by the quickest of its answers."""

import math

import pytest

from mapweave.live.map_process import ClockOffset


def test_the_quickest_answer_tells_the_offset_and_half_of_its_way_what_it_may_be_wrong_by():
    clock = ClockOffset()
    assert clock.best == (0.0, math.inf)
    clock.add(10.0, 113.0, 14.0)  # ours in the middle: 12
    clock.add(20.0, 120.75, 21.0)  # 20.5, of which it is 100.25 ahead, by 0.5 at most wrong
    clock.add(30.0, 0.0, 29.0)  # our own clock was set back meanwhile
    assert clock.best == pytest.approx((100.25, 0.5))
