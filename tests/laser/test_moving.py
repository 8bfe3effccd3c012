"""Things that move are left out of scans; what stands is not; ways that disagree for long are told."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan, Track, frozen
from mapweave.kernels.walls.segments import cast
from mapweave.laser.log_warnings import wheels_disagree, wheels_stand
from mapweave.laser.moving import MovingConfig, MovingReturns
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import OfficeConfig, TunnelConfig, simulate_office, simulate_tunnel

ANGLES = np.linspace(-2.0, 2.0, 400)
HALL = np.array([[-3, -2, 12, -2], [12, -2, 12, 4], [12, 4, -3, 4], [-3, 4, -3, -2]], float)
NOBODY = np.zeros((1, 0, 3))


def scan(pose, discs=NOBODY, walls=HALL, far=20.0, sensor=(0.0, 0.0, 0.0)):
    """What a scanner at `pose` sees of the walls and of round bodies (x, y, radius)."""
    bodies = np.array(discs, float).reshape(1, -1, 3)
    r, what, _ = cast(np.array(pose, float)[None], ANGLES, frozen(walls), bodies, 30.0)
    hit = (what[0] >= 0) & (r[0] < far)
    return Scan(np.where(hit, r[0], far), hit, None, ANGLES[0], ANGLES[1] - ANGLES[0], far, np.array(sensor))


def left_out(bodies, poses, known=None, cfg=None, **how):
    """Which returns of each scan are left out, one a half second. bodies(k): discs at scan k."""
    found = MovingReturns(cfg or MovingConfig())
    out = []
    for k, pose in enumerate(poses):
        seen = scan(pose, [bodies(k)], **how)
        clean = found.cleaned(0.5 * k, seen, np.array(pose if known is None else known[k], float))
        assert not (clean.hit & ~seen.hit).any()
        out.append((seen.hit & ~clean.hit, seen))
    assert found.count == sum(int(gone.sum()) for gone, _ in out)
    return out


def near(seen, at, by=0.3):
    """Returns within `by` [m] of a place on the ground."""
    points = seen.ranges[:, None] * np.column_stack([np.cos(seen.angles()), np.sin(seen.angles())])
    return seen.hit & (np.hypot(*(points - at).T) < by)


STILL = [(0.0, 0.0, 0.0)] * 10
AHEAD = [(0.3 * k, 0.0, 0.0) for k in range(10)]


def test_somebody_who_walks_across_is_left_out_and_the_hall_is_not():
    walker = lambda k: [(4.0, -1.5 + 0.4 * k, 0.22)]
    for gone, _ in left_out(walker, STILL)[4:]:
        assert gone.sum() >= 5
    gone, seen = left_out(walker, STILL)[6]
    assert np.array_equal(gone, near(seen, [4.0, 0.9]))


def test_somebody_who_walks_ahead_hides_his_own_past_and_is_left_out_all_the_same():
    for gone, seen in left_out(lambda k: [(2.0 + 0.55 * k, 0.0, 0.22)], AHEAD)[4:8]:
        assert gone.sum() >= 0.8 * near(seen, [seen.ranges[200] + 0.1, 0.0]).sum() > 0


def test_where_wheels_tell_headings_badly_nothing_is_left_out():
    def gone(error):
        found = MovingReturns(MovingConfig())
        out = []
        for k in range(40):
            seen = scan((0.0, 0.0, 0.0), [[(4.0, -1.5 + 0.4 * (k % 8), 0.22)]])
            clean = found.cleaned(0.5 * k, seen, np.array([0.0, 0.0, error * (-1.0) ** k]))
            found.correct(np.zeros(3))
            out.append(int((seen.hit & ~clean.hit).sum()))
        return out

    assert sum(gone(0.001)[20:]) > 20
    assert sum(gone(0.03)[20:]) == 0


def test_what_stands_is_kept_also_where_it_comes_out_from_behind_something():
    post, box = (5.0, 0.6, 0.15), (3.0, 0.9, 0.4)
    for gone, _ in left_out(lambda _: [post, box], [(0.4 * k, -0.1 * k, 0.03 * k) for k in range(10)]):
        assert not gone.any()


def test_somebody_who_stops_is_part_of_the_map_again_after_a_while():
    stops = lambda k: [(4.0, min(-1.5 + 0.5 * k, 0.5), 0.22)]
    out = left_out(stops, [(0.0, 0.0, 0.0)] * 14)
    assert out[4][0].any()
    assert not out[-1][0].any()


def test_a_pose_that_is_off_does_not_make_the_hall_move():
    astray = [(0.0, 0.0, 0.12 * k) for k in range(10)]  # turns that were never made
    for gone, seen in left_out(lambda _: [(4.0, 0.5, 0.2)], STILL, known=astray):
        assert gone.sum() <= 0.3 * seen.hit.sum()


def test_a_scanner_that_changes_its_beams_begins_anew():
    found = MovingReturns(MovingConfig())
    a = scan((0.0, 0.0, 0.0))
    b = replace(a, ranges=a.ranges[::2], hit=a.hit[::2], angle_increment=2 * a.angle_increment)
    for k, seen in enumerate((a, b, a, b)):
        assert found.cleaned(0.5 * k, seen, np.zeros(3)) is seen


def test_earlier_scans_are_held_against_from_where_they_are_said_to_be_made():
    """Wheels stand still while the robot drives: only the corrected poses tell what stands."""
    found = MovingReturns(MovingConfig())
    for k, pose in enumerate(AHEAD):
        seen = scan(pose, [[(6.0, 1.0, 0.2)]])
        assert found.cleaned(0.5 * k, seen, np.array(pose)) is seen
        found.correct(np.array(pose))
    assert found.count == 0


@pytest.fixture(scope="module")
def tunnel():
    drive = TunnelConfig(length=50.0).drive
    return simulate_tunnel(TunnelConfig(length=50.0, drive=replace(drive, people=3)), 1)


def error(made, truth):
    at = np.searchsorted(truth.t, made.track.t)
    T = se2.align(made.track.pose[:, :2], truth.pose[at, :2])
    return float(np.sqrt(np.mean(np.square(se2.act(T, made.track.pose[:, :2]) - truth.pose[at, :2]).sum(axis=1))))


@pytest.mark.slow
def test_three_walkers_in_a_tunnel_do_not_drag_the_robot_along_and_ways_that_disagree_are_told(tunnel):
    cfg = LaserConfig(method="graph", feature="none")
    blind = map_laser(tunnel.log, replace(cfg, moving=replace(cfg.moving, leave_out=False)), 0)
    made = map_laser(tunnel.log, cfg, 0)
    assert error(made, tunnel.truth) < 0.5 * error(blind, tunnel.truth)
    assert made.dropped["return of something that moves"] > 500
    assert "wheels-disagree" in {f.code for f in blind.findings}
    assert "wheels-disagree" not in {f.code for f in made.findings}
    assert "return of something that moves" not in blind.dropped


def way(*lengths):
    x = np.concatenate([[0.0], np.cumsum(np.repeat(np.array(lengths) / 10, 10))])
    return Track(np.arange(len(x), dtype=float), np.column_stack([x, 0 * x, 0 * x]))


def test_only_a_long_disagreement_of_scans_and_wheels_is_a_warning():
    wheels = way(*[2.0] * 12)
    for short in (way(*[2.0] * 12), way(*[2.0] * 5, 1.0, 1.0, *[2.0] * 5), way(*[1.8] * 12)):
        assert wheels_disagree(short, wheels, "1") == ()
    (told,) = wheels_disagree(way(*[2.0] * 3, *[1.0] * 6, *[2.0] * 3), wheels, "1")
    assert (told.code, told.span) == ("wheels-disagree", (30.0, 91.0))
    assert told.value == {"scans": pytest.approx(6.2), "wheels": pytest.approx(12.2)}
    assert wheels_disagree(wheels, None, "1") == ()


def test_wheels_that_report_no_motion_of_a_robot_that_drives_are_a_warning():
    drives = way(*[2.0] * 12)
    stands = Track(drives.t, 0.0 * drives.pose)
    (told,) = wheels_stand(drives, stands, "1")
    assert (told.code, told.span) == ("wheels-stand", (0.0, 120.0))
    assert told.value == {"way": pytest.approx(24.0), "times": 1}
    jitter = Track(drives.t, drives.pose[::-1] * 0.0 + 0.2 * (np.arange(len(drives.t)) % 2)[:, None])
    assert wheels_stand(jitter, stands, "1") == ()
    assert wheels_stand(drives, drives, "1") == ()
    assert wheels_stand(drives, None, "1") == ()
    some = drives.pose.copy()
    some[30:60], some[90:] = some[30], some[90]
    (told,) = wheels_stand(drives, Track(drives.t, some), "1")
    assert (told.span, told.value["times"]) == ((30.0, 59.0), 2)
    assert 11.0 < told.value["way"] < 12.0


@pytest.fixture(scope="module")
def office():
    """An office seen far and all over from along its corridor; turns are driven, not jumped."""
    cfg = OfficeConfig(rooms=2, visited=1)
    scanner = replace(cfg.drive.scanner, far=15.0, beams=181)
    return simulate_office(replace(cfg, drive=replace(cfg.drive, scan_every=0.1, scanner=scanner)), 3)


@pytest.mark.slow
def test_a_log_whose_wheels_stand_is_mapped_from_its_scans_alone_and_warned_of(office):
    log = office.log
    still = replace(
        log,
        scans=tuple(replace(one, odometry=np.zeros(3)) for one in log.scans),
        odometry=Track(log.odometry.t, 0.0 * log.odometry.pose, frame="odom"),
    )
    cfg = LaserConfig(method="graph", feature="none")
    made = map_laser(still, cfg, 0)
    assert error(made, office.truth) < 0.3
    assert "wheels-stand" in {f.code for f in made.findings}
    bare = replace(log, scans=tuple(replace(one, odometry=None) for one in log.scans), odometry=None)
    alone = map_laser(bare, cfg, 0)
    assert error(alone, office.truth) < 0.3
    assert "wheels-stand" not in {f.code for f in alone.findings}
