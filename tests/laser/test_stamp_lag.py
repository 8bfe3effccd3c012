"""A lag between the clocks of scanner and odometry is found from turns; without turns, or in disorder, none is told."""

import numpy as np
import pytest

from mapweave.core.records import Track
from mapweave.laser import log_warnings
from mapweave.laser.log_warnings import LAG_CAPPED, LAG_TURN, clock_drift, lag_found, stamp_lag


def turns(seed, lag, n=600, noise=0.003):
    """Stamps of scans, headings matched then, and odometry ten times a second; scans are stamped `lag` late [s]."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(10 * n // 4)
    rate = np.repeat(rng.choice([-0.8, 0.0, 0.0, 0.6], len(t) // 15 + 1), 15)[: len(t)]
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1] * 0.1)])
    at = np.arange(4.0, t[-1] - 4.0, 0.25)
    seen = np.interp(at - lag, t, heading) + noise * rng.standard_normal(len(at))
    return at, seen, Track(t, np.column_stack([0 * t, 0 * t, np.angle(np.exp(1j * heading))]))


@pytest.mark.parametrize("lag", [0.0, 0.5, 2.0, -0.5])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_lag_of_scans_behind_odometry_is_found(seed, lag):
    found = stamp_lag(*turns(seed, lag))
    assert (found is None or found == 0.0) if lag == 0.0 else found == pytest.approx(lag, abs=0.051)


def test_a_lag_is_told_with_its_length_and_which_comes_later():
    (late,), (early,) = lag_found(0.5, None, "1"), lag_found(-0.35, None, "1")
    assert late.text.startswith("the scans bear stamps 0.50 s after those of the odometry")
    assert early.text.startswith("the scans bear stamps 0.35 s before those of the odometry")
    assert lag_found(None, None, "1") == lag_found(0.1, None, "1") == ()


@pytest.mark.parametrize("rate", [0.01, -0.03, 0.05])
@pytest.mark.parametrize("seed", [5, 6])
def test_a_clock_that_runs_faster_is_found_and_is_no_lag(seed, rate):
    t, seen, odometry = turns(seed, 0.0)
    drifted = t[0] + (1.0 + rate) * (t - t[0])
    assert stamp_lag(drifted, seen, odometry) is None
    assert clock_drift(drifted, seen, odometry) == pytest.approx(rate, abs=0.0016)
    (told,) = lag_found(0.5, rate, "1")
    assert told.text.startswith(f"the clock of the scans runs {100 * abs(rate):.1f} % {'fas' if rate > 0 else 'slow'}")


def test_no_drift_is_found_of_clocks_that_agree_or_lag_nor_of_other_wheels():
    assert clock_drift(*turns(7, 0.0)) is None
    assert clock_drift(*turns(7, 2.0)) is None
    for seed in range(8, 12):
        t, seen, _ = turns(seed, 0.0)
        assert clock_drift(t, seen, turns(seed + 10, 0.0)[2]) is None


def test_nothing_is_found_where_nothing_turns_or_headings_have_nothing_in_common():
    t, seen, odometry = turns(3, 0.5)
    assert stamp_lag(t, 0.0 * seen, odometry) is None
    assert stamp_lag(t, turns(4, 0.5)[1], odometry) is None
    assert stamp_lag(t, seen, None) is None
    assert stamp_lag(t[:1], seen[:1], odometry) is None


def test_a_lag_that_explains_too_little_of_the_difference_is_not_found(monkeypatch):
    t, seen, odometry = turns(1, 0.5, noise=0.03)
    heads = np.unwrap(odometry.pose[:, 2])

    def left(lag):
        turned, by = np.diff(seen), np.diff(np.interp(t - lag, odometry.t, heads))
        turning = np.abs(turned) >= LAG_TURN
        return np.minimum(np.abs(turned - by)[turning], LAG_CAPPED).mean()

    share = left(0.5) / left(0.0)
    assert 0.1 < share < 0.9
    monkeypatch.setattr(log_warnings, "LAG_GAIN", 1.02 * share)
    assert stamp_lag(t, seen, odometry) == pytest.approx(0.5, abs=0.051)
    monkeypatch.setattr(log_warnings, "LAG_GAIN", 0.98 * share)
    assert stamp_lag(t, seen, odometry) is None
