"""The robot's own body and greatest ranges that stand for nothing are left out and counted; walls are not."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.io.assemble import RawLog, RawScan
from mapweave.io.scan_checks import GREATEST, HELD, OWN, REPEAT, moved_by, repeated, without_false_returns

from .test_scan_agreement import drive


def changed(scans, change):
    return [replace(scan, ranges=change(np.array(scan.ranges)), hit=np.ones(len(scan.hit), bool)) for scan in scans]


def body(ranges, at=slice(60, 90), depth=0.2):
    ranges[at] = depth
    return ranges


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_walls_are_left_alone(seed):
    scans = drive(seed)
    out, left = without_false_returns(scans)
    assert not left
    assert all(a is b for a, b in zip(out, scans, strict=True))


def test_beams_that_see_the_robot_itself_are_left_out_and_counted():
    scans = drive(1)
    out, left = without_false_returns(changed(scans, body))
    assert left == {OWN: 30 * len(scans)}
    for scan, before in zip(out, scans, strict=True):
        assert not scan.hit[60:90].any()
        assert np.array_equal(scan.ranges[:60], before.ranges[:60])


def test_a_wall_beside_a_robot_that_drives_straight_on_is_no_part_of_it():
    scans = drive(1)
    still = [replace(scan, odometry=scan.odometry * [1.0, 1.0, 0.0]) for scan in changed(scans, body)]
    assert not without_false_returns(still)[1]
    alone = [replace(scan, odometry=None) for scan in changed(scans, body)]
    assert not without_false_returns(alone)[1]


def gripped(scan, sides):
    """The scan as it is while something stands 0.12 m away in these directions, and 0.3 m in one beam."""
    ranges = np.array(scan.ranges)
    ranges[np.isin(np.arange(len(ranges)) * 6 // len(ranges), sides)] = 0.12
    ranges[len(ranges) // 2] = 0.3
    return replace(scan, ranges=ranges, hit=np.ones(len(ranges), bool))


def all_round(scans):
    return [replace(s, angle_min=-np.pi, angle_increment=2 * np.pi / len(s.ranges)) for s in scans]


def test_hands_that_close_round_the_scanner_for_a_while_are_left_out_and_counted():
    scans = all_round(drive(1))
    out, left = without_false_returns([gripped(s, (0, 2, 4)) if 20 <= k < 40 else s for k, s in enumerate(scans)])
    n = len(scans[0].ranges)
    held = np.isin(np.arange(n) * 6 // n, (0, 2, 4))
    held[n // 2] = True
    assert left == {HELD: 20 * int(held.sum())}
    assert np.array_equal(out[30].hit, ~held)
    assert out[19] is scans[19]


@pytest.mark.parametrize(("sides", "share"), [((0, 1), 0.2), ((0, 2, 4), 0.6), ((0,), 0.2)])
def test_a_wall_on_one_side_a_narrow_place_and_what_is_small_are_left_alone(sides, share):
    scans = all_round(drive(1))
    near = [gripped(s, sides) if k < share * len(scans) else s for k, s in enumerate(scans)]
    assert HELD not in without_false_returns(near)[1]


@pytest.mark.parametrize("limit", [4.8, 5.5])
def test_a_greatest_range_that_many_returns_have_exactly_is_no_return(limit):
    scans = drive(2)
    seen = changed(scans, lambda r: np.minimum(r, limit))
    out, left = without_false_returns(seen)
    assert left == {GREATEST: sum(int((scan.ranges == limit).sum()) for scan in seen)}
    assert left[GREATEST] > 1000
    assert all((scan.ranges[scan.hit] < limit).all() for scan in out)
    rounded = changed(scans, lambda r: np.round(np.minimum(r, limit), 2))
    assert without_false_returns(rounded)[1][GREATEST] >= left[GREATEST]


def test_ranges_rounded_to_centimetres_and_a_robot_that_stands_have_no_such_range():
    assert not without_false_returns(changed(drive(3), lambda r: np.round(r, 2)))[1]
    (one,) = drive(3)[:1]
    rng = np.random.default_rng(1)
    still = changed([one] * 300, lambda r: np.round(r + rng.normal(0.0, 0.01, len(r)), 2))
    assert not without_false_returns(still)[1]


@pytest.mark.parametrize("used", [False, True])
def test_a_log_leaves_false_returns_out_or_says_that_a_map_has_them_already(used):
    log = RawLog("1", "here", "")
    for k, scan in enumerate(changed(drive(4), body)):
        log.scans.append(
            RawScan(0.2 * k, scan.ranges, None, scan.angle_min, scan.angle_increment, 0.0, 30.0, odometry=scan.odometry)
        )
    made = log.finish(used=used)
    n = 30 * len(made.scans)
    assert made.dropped.get(OWN, 0) == (0 if used else n)
    assert (f"{n} returns seem false and are in the map: {OWN}" in made.warnings) == used


def again(scans, every):
    """Each of the scans sent `every` times, the later ones where the robot is on its way to the next."""
    out = []
    for a, b in pairwise(scans):
        way = se2.between(a.odometry, b.odometry)
        out += [replace(a, odometry=se2.compose(a.odometry, way * (k / every))) for k in range(every)]
    return [*out, scans[-1]]


@pytest.mark.parametrize("every", [2, 3])
def test_a_revolution_that_a_driver_sends_again_is_one_scan(every):
    scans = drive(1)
    moves = np.array([np.abs(se2.between(a.odometry, b.odometry)).max() > 1e-6 for a, b in pairwise(scans)])
    told = repeated(again(scans, every))
    assert np.array_equal(told[:-1].reshape(-1, every), [[False, *[m] * (every - 1)] for m in moves])
    assert not repeated(scans).any()
    standing = [replace(scan, odometry=scans[0].odometry) for scan in [scans[0]] * 5]
    assert not repeated(standing).any()


def test_without_wheels_a_scan_that_comes_twice_is_one_and_what_stands_is_many():
    scans = [replace(scan, odometry=None) for scan in drive(1)[:40]]
    twice = [scan for scan in scans for _ in range(2)]
    assert np.array_equal(np.flatnonzero(repeated(twice)), np.arange(1, 80, 2))
    assert not repeated([*scans, *[scans[-1]] * 9]).any()


def test_a_copy_now_and_then_and_a_scanner_that_is_stuck_are_left_alone():
    scans = drive(1)
    once = [*scans[:20], replace(scans[19], odometry=np.add(scans[19].odometry, 0.05)), *scans[20:]]
    assert not repeated(once).any()
    assert not repeated(changed(scans, lambda r: np.linspace(1.0, 2.0, len(r)))).any()


def test_scans_of_a_scanner_that_hangs_while_the_robot_drives_on_are_no_new_ones():
    scans = drive(1)
    far = next(k for k in range(11, len(scans)) if moved_by(scans[10], scans[k]) > 0.5)
    hung = [replace(scans[10], odometry=scan.odometry) if 10 < k <= far else scan for k, scan in enumerate(scans)]
    assert np.array_equal(np.flatnonzero(repeated(hung)), np.arange(11, far + 1))
    spun = [replace(scans[10], odometry=scans[10].odometry + 1e-3 * k) for k in range(9)]
    assert not repeated([*scans[:10], *spun, *scans[10:]]).any()  # it stands, and its wheels tremble


def test_a_log_counts_the_scans_that_repeat_and_a_resumed_one_keeps_them():
    scans = again(drive(1), 2)
    raw = [
        RawScan(0.1 * k, s.ranges, None, s.angle_min, s.angle_increment, 0.0, 30.0, odometry=s.odometry)
        for k, s in enumerate(scans)
    ]
    log = RawLog("1", "a.log", "", list(raw)).finish()
    count = int(repeated(scans).sum())
    assert count > 50
    assert log.dropped[REPEAT] == count == len(scans) - len(log.scans)
    assert len(log.scan_t) == len(log.scans)
    assert log.odometry is not None
    assert len(log.odometry.t) == len(scans)
    assert len(RawLog("1", "a.log", "", list(raw)).finish(used=True).scans) == len(scans)
