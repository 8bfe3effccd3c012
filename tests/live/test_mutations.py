"""Mutated messages of every kind among those of honest robots; `benchmarks/live_mutations.py` tells many more."""

import live_mutations
import pytest


@pytest.mark.parametrize("sensor", ["landmarks", "laser", "ranges"])
def test_whatever_is_told_in_between_honest_robots_are_heard_to_the_byte_and_nothing_is_raised(sensor):
    told = live_mutations.told_among_mutations(sensor, 2000, seed=7)
    assert told.whole
    assert told.refused.total() > 1500
    assert {"malformed", "implausible", "version", "forged name"} <= set(told.refused)
