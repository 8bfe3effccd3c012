"""Stamps that cannot be: scans are taken in the file's order, spaced as usual, and it is told; right ones stay."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.io.assemble import RawLog, RawScan
from mapweave.io.scan_checks import mended_stamps

T = 100.0 + 0.2 * np.arange(200)
NEW = np.ones(200, bool)


def raw(t, odometry=None, *, own=True, seed=0):
    """A log whose scans all differ, with these stamps; the robot drives 2 cm from scan to scan."""
    rng = np.random.default_rng(seed)
    out = RawLog("1", "made", "")
    for k, stamp in enumerate(t):
        pose = np.array([0.02 * k, 0.0, 0.0]) if own else None
        out.scans.append(RawScan(float(stamp), rng.uniform(1, 5, 60), None, -1.5, 0.05, 0.0, 30.0, odometry=pose))
    out.odometry = [] if odometry is None else [(float(s), 0.02 * k, 0.0, 0.0) for k, s in enumerate(odometry)]
    return out


def told(log):
    return {f.code: f.value for f in log.findings if "stamps" in f.code or "untimed" in f.code}


def test_right_stamps_stay_also_where_rows_are_a_little_late_or_written_twice():
    assert mended_stamps(T, NEW) is None
    late = T.copy()
    late[[50, 53]], late[90] = late[[53, 50]], late[89]
    assert mended_stamps(late, NEW) is None
    assert mended_stamps(np.repeat(T, 2), np.tile([True, False], 200)) is None
    assert mended_stamps(np.zeros(5), np.zeros(5, bool)) is None


@pytest.mark.parametrize("value", [0.0, 1.7e9])
@pytest.mark.parametrize(("step", "spaced"), [(None, 1.0), (0.1, 0.1)])
def test_equal_stamps_become_the_files_order_spaced_as_stated_or_by_a_second(value, step, spaced):
    made = mended_stamps(np.full(200, value), NEW, step)
    assert (made.what, made.rows) == ("equal", 199)
    np.testing.assert_allclose(made.t, value + spaced * np.arange(200), atol=1e-6)


@pytest.mark.parametrize("to", [1.0, 0.5])
def test_rounded_stamps_are_spread_to_within_half_a_step_of_the_true_ones(to):
    made = mended_stamps(np.floor(T / to) * to, NEW)
    assert made.what == "rounded"
    assert (np.diff(made.t) > 0).all()
    assert np.abs(made.t - T).max() <= 0.101 + to * 0.2


def test_a_gap_stays_where_stamps_are_rounded():
    gone = np.concatenate([T[:100], T[100:] + 30.0])
    made = mended_stamps(np.floor(gone), NEW)
    assert np.diff(made.t)[99] > 29.0
    assert np.delete(np.diff(made.t), 99).max() < 0.5


def test_a_clock_that_is_set_back_goes_on_by_the_usual_step():
    back = np.concatenate([T[:80], T[80:] - 3600.0])
    made = mended_stamps(back, NEW)
    assert (made.what, made.rows) == ("back", 1)
    np.testing.assert_allclose(made.t, T, atol=1e-6)


def test_stamps_that_are_zero_now_and_then_are_bridged():
    holes = T.copy()
    holes[[40, 41, 120]] = 0.0
    np.testing.assert_allclose(mended_stamps(holes, NEW).t, T, atol=1e-6)


@pytest.mark.parametrize("junk", [0.0, -5.0, "any"])
def test_odometry_rows_without_a_stamp_between_others_are_left_out_and_counted(junk):
    """As of programs that write a row after each scan and never set its stamp: the trajectory began at 0 s, far off."""
    stamps = np.repeat(T, 2)
    stamps[101::2] = np.random.default_rng(2).choice([0.0, 1e-48, 9.9], 150) if junk == "any" else junk
    stamps[102] = stamps[101]  # two in a row
    log = raw(T, stamps, own=False).finish()
    assert log.dropped["odometry row whose time is not known"] == 151
    assert told(log) == {}
    assert log.odometry.t[0] == T[0]
    np.testing.assert_allclose([s.odometry[0] for s in log.scans[60:]], 0.04 * np.arange(60, 200), atol=1e-9)


def test_odometry_rows_without_a_stamp_are_found_beside_one_that_is_early():
    stamps = np.repeat(T, 2)
    stamps[101::2] = 0.0
    stamps[120] = stamps[134]  # as latest as any until there: rows before it are not on time
    log = raw(T, stamps, own=False).finish()
    assert log.dropped["odometry row whose time is not known"] == 150
    assert log.odometry.t[0] == T[0]


def test_rows_of_a_second_logger_whose_clock_is_behind_are_kept():
    both = np.column_stack([T, T + 0.1 - 60.0]).ravel()
    log = raw(T, both).finish()
    assert len(log.odometry.t) == len(np.unique(both))
    assert told(log)["stamps-back"]["what"] == "odometry"


def test_of_stamps_nearly_all_of_which_are_one_the_others_tell_no_time_either():
    """As where a clock passed zero and seconds were written to six digits: the log was spread over 60,000 years."""
    wrapped = np.full(200, 4.29497e9)
    wrapped[:4] = -0.446, -0.913, -1.343, -1.82
    log = raw(wrapped, np.append(wrapped, -30.0)).finish()
    assert told(log)["stamps-equal"]["value"] == 195
    np.testing.assert_allclose(np.diff(log.scan_t), 1.0)
    assert log.odometry is None or np.isin(log.odometry.t, log.scan_t).all()


def test_a_log_without_usable_stamps_is_read_whole_by_the_poses_that_its_scans_bear():
    log = raw(np.zeros(200), T).finish()
    assert len(log.scans) == 200
    assert told(log) == {"stamps-equal": {"what": "scans", "value": 199, "all": 200}}
    assert [s.odometry[0] for s in log.scans] == pytest.approx(0.02 * np.arange(200))
    assert log.dropped == {"odometry row whose time is not known": 200}


def test_wheels_that_nothing_ties_to_scans_in_time_are_left_out_and_it_is_told():
    for scans, wheels in ((np.zeros(200), T), (T, np.zeros(200))):
        log = raw(scans, wheels, own=False).finish()
        assert told(log)["wheels-untimed"] == 200
        assert log.odometry is None
        assert len(log.scans) == 200


def test_wheels_rounded_with_the_scans_are_spread_with_them():
    log = raw(np.floor(T), np.floor(T), own=False).finish()
    assert told(log)["stamps-rounded"]["what"] in {"scans", "odometry"}
    places = np.array([s.odometry[0] for s in log.scans])
    assert np.abs(places - 0.02 * np.arange(200)).max() < 0.02


def test_two_scanners_with_equal_stamps_are_right():
    log = raw(np.repeat(T[:100], 2))
    behind = np.array([-0.3, 0.0, np.pi])
    log.scans = [replace(s, T_robot_sensor=behind) if k % 2 else s for k, s in enumerate(log.scans)]
    log = log.finish()
    assert told(log) == {}
    assert len(log.scans) == 200


def test_a_clock_set_back_is_told_with_how_often():
    log = raw(np.concatenate([T[:80], T[80:] - 3600.0])).finish()
    assert told(log) == {"stamps-back": {"what": "scans", "value": 1}}
    np.testing.assert_allclose(log.scan_t, T, atol=1e-6)
