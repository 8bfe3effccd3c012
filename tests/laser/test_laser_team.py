"""Laser SLAM of a team: one map, honest about where every keyframe was, whatever is lost on the way."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.laser.closures import Matched
from mapweave.laser.keyframes import KeyframeScan
from mapweave.laser.occupancy_mapper import LayingConfig, OccupancyMapper
from mapweave.mapping import laser_team
from mapweave.mapping.laser_team import LaserTeam

from .buildings import drive, errors, estimate, lap, ring, rooms, wall_distance


def ring_drive(seed):
    """Two robots round a ring of corridors, one each way."""
    a, b = lap(), lap(backwards=True)
    return drive(ring(seed=seed), [(*a[0], 0.0), (*b[0], np.pi)], [a[1:], b[1:]], seed)


@pytest.fixture(scope="module")
def ring_run():
    return ring_drive(0)


@pytest.fixture(scope="module")
def watched(ring_run):
    """The team that drove the ring, how many scans its map laid anew, and where each robot saw itself by itself."""
    laid, own = [], []

    def watch(k, team):
        own.append([track.local.copy() for track in team.tracks])
        if k % 7 == 0:
            laid.append(team.mapper(0.1).update(team.scans, team.scan_poses()))

    return estimate(ring_run, after=watch), sum(laid), np.array(own)


@pytest.fixture(scope="module")
def office():
    return drive(*rooms(300, 2, 3, 4), 3, steps=200)


@pytest.fixture(scope="module")
def office_team(office):
    return estimate(office)


@pytest.mark.slow
def test_loops_that_close_take_the_drift_out_of_the_map(ring_run, watched, monkeypatch):
    monkeypatch.setattr(laser_team, "CLOSURE_TRIES", 0)
    closed, open_ = watched[0], estimate(ring_run)
    e, without = errors(closed, ring_run)[0], errors(open_, ring_run)[0]
    assert np.hypot(*e[:, :2].T).mean() < 0.4 * np.hypot(*without[:, :2].T).mean()
    d, apart = wall_distance(closed, ring_run), wall_distance(open_, ring_run)
    assert d.mean() < 0.07
    assert d.mean() < 0.8 * apart.mean()
    assert np.quantile(d, 0.95) < 0.2
    assert sum(c.accepted for c in closed.closures) > 20
    assert all(c.reason for c in closed.closures)


def test_an_office_driven_by_two_comes_out_within_a_cell(office, office_team):
    assert np.hypot(*errors(office_team, office)[0][:, :2].T).mean() < 0.04
    assert wall_distance(office_team, office).mean() < 0.08
    assert {c.robots for c in office_team.closures if c.accepted} >= {(0, 1), (1, 0)}


@pytest.mark.slow
def test_keyframes_err_as_far_as_the_team_says_they_may(office, office_team, ring_run, watched):
    found = [errors(office_team, office)[1], errors(watched[0], ring_run)[1]]
    for seed in (21,):
        run = ring_drive(seed)
        found.append(errors(estimate(run), run)[1])
        run = drive(*rooms(400, 2, seed, 4), seed, steps=200)
        found.append(errors(estimate(run), run)[1])
    assert 0.3 < np.mean(found) < 1.5  # of four drives, each of which errs in a few directions only


def test_the_same_scans_give_the_same_map_to_the_last_bit(office, office_team):
    again = estimate(office)
    assert np.array_equal(again.graph().pose, office_team.graph().pose)
    assert np.array_equal(again.covariances(), office_team.covariances())
    assert np.array_equal(again.grid(0.1).passes, office_team.grid(0.1).passes)


def test_a_map_kept_up_to_date_is_exactly_the_map_drawn_anew(watched):
    team, laid, _ = watched
    kept = team.grid(0.1)
    assert laid > len(team.scans)  # some were laid anew
    mapper = team.mapper(0.1)
    fresh = type(mapper)(0.1, mapper.cfg)
    fresh.update(team.scans, mapper.laid)
    again = fresh.grid()
    for name in ("origin", "hits", "passes", "mean"):
        assert np.array_equal(getattr(kept, name), getattr(again, name)), name
    d = team.scan_poses() - mapper.laid
    assert np.hypot(d[:, 0], d[:, 1]).max() <= 0.05
    assert np.abs(se2.wrap_angle(d[:, 2])).max() <= np.radians(0.5)


def test_where_a_robot_thinks_it_is_never_jumps_in_its_own_frame(watched):
    step = se2.between(watched[2][:-1], watched[2][1:])
    assert np.hypot(step[..., 0], step[..., 1]).max() < 0.4  # 0.3 m driven


def test_a_wrong_closure_is_named_and_leaves_no_trace(office):
    team = estimate(office)
    right = team.graph().pose
    first, second = 3, len(right) - 1
    wrong = se2.compose(se2.between(right[first], right[second]), np.array([0.8, 0.4, 0.1]))
    sure = np.diag([2500.0, 2500.0, 40_000.0])
    team.team.close(first, second, Matched(True, "planted", wrong, sure, np.zeros(3), 1.0, 0.0))
    team.optimise(force=True)
    assert not team.closures[-1].accepted
    assert "contradicts" in team.closures[-1].reason
    assert np.abs(team.graph().pose - right).max() < 0.02


def test_a_lost_message_waits_and_arrives(office, office_team):
    late = estimate(office, deliver=lambda k, j: j == 0 or not 100 <= k < 150)
    assert late.waiting(1) == 0
    assert len(late.graph()) == len(office_team.graph())
    assert wall_distance(late, office).mean() < 0.1


def test_a_dead_robot_leaves_what_it_had_told(office):
    def remove(k, team):
        if k == 120:
            team.remove_robot(1)

    team = estimate(office, deliver=lambda k, j: j == 0 or k < 80, after=remove)
    last = team.stamp[team.owner == 1].max()
    assert last <= office.t[80]
    assert (team.owner == 1).sum() > 5
    assert team.trajectory(1).t.max() <= office.t[80]
    assert np.array_equal(team.poses()[1], team.graph().pose[np.flatnonzero(team.owner == 1)[-1]])
    assert team.trajectory(0).t.max() == office.t[-1]


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
        team.add_scan(0, float(k), replace(nothing, odometry=at))
        team.add_scan(1, float(k), replace(wall, odometry=at))
        for j in range(2):
            team.deliver(j)
        team.optimise()
    assert np.abs(team.poses() - [[0.0, 1.1, 0.0], [0.0, 6.1, 0.0]]).max() < 0.1
    assert np.isfinite(team.covariances()).all()
    last = team.covariances()[np.flatnonzero(team.owner == 1)[-1]]
    along, across = last[1, 1] - 0.01**2, last[0, 0] - 0.01**2 - (1.1 * 0.0087) ** 2  # less what the start brought
    assert along > 0.8 * 0.6 * 0.033**2  # along a bare wall only the wheels tell
    assert across < 0.5 * along
    assert team.grid(0.1).passes.sum() > 0


def test_what_teammates_send_back_is_not_a_wall():
    n = 360
    r = np.full(n, 12.0)
    r[175:186] = 1.8  # a disc 2 m ahead
    scan = Scan(r, r < 12.0, None, -np.pi, 2 * np.pi / n, 12.0, odometry=np.zeros(3))
    team = LaserTeam(None, np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    team.add_scan(0, 0.0, scan)
    team.deliver(0)
    assert team.grid(0.1).hits.sum() == 0
    alone = LaserTeam(None, np.zeros((1, 3)))
    alone.add_scan(0, 0.0, scan)
    alone.deliver(0)
    assert alone.grid(0.1).hits.sum() == 11


def test_a_wall_seen_from_near_is_not_drawn_again_from_afar():
    none = np.zeros((0, 2))
    mapper = OccupancyMapper(0.1, LayingConfig(near=6.0))
    near = KeyframeScan(0, 0, 0.0, np.zeros(3), np.array([[2.05, 0.05]]), none, np.zeros(2))
    far = near._replace(points=np.array([[8.15, 0.05], [8.15, 3.05]]))
    mapper.update([near, far], np.array([[0.0, 0.0, 0.0], [-6.0, 0.0, 0.0]]))
    grid = mapper.grid()
    row, col = np.nonzero(grid.hits)
    assert np.allclose(grid.mean[row, col], [[2.05, 0.05], [2.15, 3.05]], atol=1e-4)
    behind = np.floor((np.array([2.15, 0.05]) - grid.origin) / 0.1 + 1e-9).astype(int)
    assert grid.passes[behind[1], behind[0]] == 0  # unknown, not free
