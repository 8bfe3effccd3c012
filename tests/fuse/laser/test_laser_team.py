"""Laser SLAM of a team: one map, honest about where every keyframe was, whatever is lost on the way."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.fuse.laser import LaserTeam, LaserTeamConfig
from mapweave.fuse.laser.closures import Matched

from .buildings import drive, errors, estimate, lap, ring, rooms, wall_distance

NO_LOOPS = replace(LaserTeamConfig(), closures=replace(LaserTeamConfig().closures, tries=0))


def ring_drive(seed, noise=1.0):
    """Two robots round a ring of corridors, one each way."""
    a, b = lap(), lap(backwards=True)
    return drive(ring(seed=seed), [(*a[0], 0.0), (*b[0], np.pi)], [a[1:], b[1:]], seed, noise=noise)


@pytest.fixture(scope="module")
def round_trip():
    return ring_drive(1)


@pytest.fixture(scope="module")
def office():
    return drive(*rooms(300, 2, 3, 4), 3, steps=260)


def test_loops_that_close_take_the_drift_out_of_the_map(round_trip):
    closed, open_ = estimate(round_trip), estimate(round_trip, NO_LOOPS)
    e, without = errors(closed, round_trip)[0], errors(open_, round_trip)[0]
    assert np.hypot(*e[:, :2].T).mean() < 0.6 * np.hypot(*without[:, :2].T).mean()
    d, apart = wall_distance(closed, round_trip), wall_distance(open_, round_trip)
    assert d.mean() < 0.1
    assert d.mean() < 0.8 * apart.mean()
    assert sum(c.accepted for c in closed.closures) > 20
    assert all(c.reason for c in closed.closures)


def test_an_office_driven_by_two_comes_out_within_a_cell(office):
    team = estimate(office)
    assert np.hypot(*errors(team, office)[0][:, :2].T).mean() < 0.06
    assert wall_distance(team, office).mean() < 0.1
    assert {c.robots for c in team.closures if c.accepted} >= {(0, 1), (1, 0)}


def test_the_same_scans_give_the_same_map_to_the_last_bit(office):
    one, two = estimate(office), estimate(office)
    assert np.array_equal(one.graph().pose, two.graph().pose)
    assert np.array_equal(one.covariances(), two.covariances())
    assert np.array_equal(one.grid(0.1).passes, two.grid(0.1).passes)


def test_a_map_kept_up_to_date_is_exactly_the_map_drawn_anew(round_trip):
    moved = []

    def draw(k, team):
        if k % 7 == 0:
            moved.append(team.canvas(0.1).update(team.sweeps, team.sweep_poses()))

    team = estimate(round_trip, after=draw)
    kept = team.grid(0.1)
    assert sum(moved) > len(team.sweeps)  # some were laid anew
    canvas = team.canvas(0.1)
    fresh = type(canvas)(0.1)
    fresh.update(team.sweeps, np.array(canvas.laid))
    again = fresh.grid()
    for name in ("origin", "hits", "passes", "mean"):
        assert np.array_equal(getattr(kept, name), getattr(again, name)), name
    d = team.sweep_poses() - np.array(canvas.laid)
    assert np.hypot(d[:, 0], d[:, 1]).max() <= 0.05
    assert np.abs(se2.wrap_angle(d[:, 2])).max() <= np.radians(0.5)


def test_a_wrong_closure_is_named_and_leaves_no_trace(round_trip):
    team = estimate(round_trip)
    right = team.graph().pose
    first, second = 3, len(right) - 1
    wrong = se2.compose(se2.between(right[first], right[second]), np.array([0.8, 0.4, 0.1]))
    sure = np.diag([2500.0, 2500.0, 40_000.0])
    team.team.close(first, second, Matched(True, "planted", wrong, sure, np.zeros(3), 1.0, 0.0))
    team.optimise(force=True)
    assert not team.closures[-1].accepted
    assert "contradicts" in team.closures[-1].reason
    assert np.abs(team.graph().pose - right).max() < 0.02


def test_a_lost_message_waits_and_arrives(office):
    late = estimate(office, deliver=lambda k, j: j == 0 or not 100 <= k < 180)
    assert late.waiting(1) == 0
    assert len(late.graph()) == len(estimate(office).graph())
    assert wall_distance(late, office).mean() < 0.1


def test_a_dead_robot_leaves_what_it_had_told(office):
    def bury(k, team):
        if k == 150:
            team.bury(1)

    team = estimate(office, deliver=lambda k, j: j == 0 or k < 100, after=bury)
    last = team.stamp[team.owner == 1].max()
    assert last <= office.t[100]
    assert (team.owner == 1).sum() > 5
    assert team.trajectory(1).t.max() <= office.t[100]
    assert np.array_equal(team.poses()[1], team.graph().pose[np.flatnonzero(team.owner == 1)[-1]])
    assert team.trajectory(0).t.max() == office.t[-1]


def test_where_a_robot_thinks_it_is_never_jumps_in_its_own_frame(round_trip):
    seen = []

    def watch(k, team):
        seen.append([track.local.copy() for track in team.tracks])

    estimate(round_trip, after=watch)
    step = se2.between(np.array(seen[:-1]), np.array(seen[1:]))
    assert np.hypot(step[..., 0], step[..., 1]).max() < 0.45  # 0.3 m driven


def test_a_robot_that_sees_nothing_or_a_blank_wall_is_no_error():
    n = 90
    angle = -np.pi + 2 * np.pi / n * np.arange(n)
    nothing = Scan(np.full(n, 12.0), np.zeros(n, bool), None, -np.pi, 2 * np.pi / n, 12.0, odometry=np.zeros(3))
    r = np.where(np.cos(angle) > 0.2, 2.0 / np.maximum(np.cos(angle), 0.2), 12.0)
    wall = replace(nothing, ranges=r, hit=r < 12.0)
    team = LaserTeam(None, np.array([[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]]))
    assert np.array_equal(team.poses(), team.starts)
    assert team.grid(0.1).hits.sum() == 0
    for k in range(12):
        at = np.array([0.0, 0.1 * k, 0.0])
        team.look(0, float(k), replace(nothing, odometry=at))
        team.look(1, float(k), replace(wall, odometry=at))
        for j in range(2):
            team.deliver(j)
        team.optimise()
    assert np.abs(team.poses() - [[0.0, 1.1, 0.0], [0.0, 6.1, 0.0]]).max() < 0.1
    assert np.isfinite(team.covariances()).all()
    along = team.covariances()[:, 1, 1]
    assert along[team.owner == 1].max() > 1e-3  # along a bare wall only the wheels tell
    assert team.grid(0.1).passes.sum() > 0


def test_what_teammates_send_back_is_not_a_wall():
    n = 360
    r = np.full(n, 12.0)
    r[175:186] = 1.8  # a disc 2 m ahead
    scan = Scan(r, r < 12.0, None, -np.pi, 2 * np.pi / n, 12.0, odometry=np.zeros(3))
    team = LaserTeam(None, np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    team.look(0, 0.0, scan)
    team.deliver(0)
    assert team.grid(0.1).hits.sum() == 0
    alone = LaserTeam(None, np.zeros((1, 3)))
    alone.look(0, 0.0, scan)
    alone.deliver(0)
    assert alone.grid(0.1).hits.sum() == 11
