"""The particle filter's parts: what a scan leaves in a cell, how particles are weighed and drawn, when they move."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Event, Odometry, Scan
from mapweave.laser import particle_slam, scan_odometry
from mapweave.laser.beam import STEERING
from mapweave.laser.config import FILTER_SHARED, FILTER_SIGMA
from mapweave.laser.particle_grid import CELL_CAP, MOST_WEIGHT, CellConfig, ParticleGrid
from mapweave.laser.particle_slam import _resampled, _weighed, effective, init, log_likelihood, step, trajectory
from mapweave.mapping.config import LaserConfig

pytestmark = pytest.mark.kernel

CELLS = CellConfig(size=0.1)


def laid(points, weights, times=1, cells=CELLS):
    """The cells of one map in which a scan was laid `times` times, the robot at the origin."""
    grid = ParticleGrid(1, cells)
    for _ in range(times):
        grid.insert(
            np.zeros(1, np.intp), np.zeros((1, 3)), np.asarray(points, np.float32), np.asarray(weights, np.float32)
        )
    return grid.cells(0)


def test_weights_are_relative_to_the_greatest_and_the_effective_number_counts_equals():
    rng = np.random.default_rng(0)
    log = rng.normal(0, 3, 50) - 500.0
    share = np.exp(log - log.max())
    share /= share.sum()
    w, n_eff = effective(log)
    np.testing.assert_allclose(w / w.sum(), share)
    assert w.max() == 1.0
    assert n_eff == pytest.approx(1 / np.square(share).sum())
    assert effective(np.array([0.0, 0.0, -1e4, -1e4]))[1] == pytest.approx(2.0)


def test_a_scans_likelihood_falls_with_the_mean_squared_misfit_of_the_beams_that_enough_particles_match():
    cfg = LaserConfig()
    rng = np.random.default_rng(1)
    cap = CELL_CAP
    D = rng.uniform(0, 1.5 * cap, (8, 30)).astype(np.float32).clip(max=cap)
    for feature, neff in (("none", cfg.filter.bare_neff), (STEERING[0], cfg.filter.neff)):
        found, count = log_likelihood(D, cfg, feature)
        beams = [j for j in range(30) if (D[:, j] < cap).mean() >= FILTER_SHARED]
        assert count == len(beams)
        assert 0 < count < 30
        mean = D[:, beams].astype(float).mean(axis=1)
        np.testing.assert_allclose(found, -neff * mean / (2 * FILTER_SIGMA**2), rtol=1e-5)
    nothing, none = log_likelihood(np.full((8, 30), cap, np.float32), cfg, "none")
    assert none == 0
    assert not nothing.any()


def scan_at(pose, n=90):
    """What is seen in a room of 6 x 4 m."""
    angle = np.linspace(-2.2, 2.2, n)
    a = angle + pose[2] + 1e-9
    tx = (np.sign(np.cos(a)) * 3.0 - pose[0]) / np.cos(a)
    ty = (np.sign(np.sin(a)) * 2.0 - pose[1]) / np.sin(a)
    return Scan(np.minimum(tx, ty), np.ones(n, bool), None, -2.2, float(angle[1] - angle[0]), 30.0, odometry=pose)


def driven(xs, cfg, feature="none"):
    rng = np.random.default_rng(0)
    state = init("r", cfg, rng, feature=feature)
    infos = []
    for k, x in enumerate(xs):
        state, info = step(state, Event(float(k), "r", scan_at(np.array([x, 0.1, 0.05]))), cfg, rng)
        infos.append(info)
    return state, infos


def small(**how):
    return LaserConfig(particles=6, threads=1, **how)


def test_particles_move_when_the_robot_has_gone_far_enough_since_they_last_did():
    cfg = small()
    d = cfg.filter.update_distance
    state, infos = driven([0.0, 0.6 * d, 1.2 * d, 1.7 * d, 2.4 * d], cfg)
    assert [row for row, _, _ in state.history] == [0, 2, 4]
    assert [info.decision == "skipped" for info in infos] == [False, True, False, True, False]
    assert [now.shape for _, now, _ in state.history] == [(6, 3)] * 3


@pytest.mark.parametrize(("share", "always"), [(1.0, True), (0.0, False)])
def test_an_update_tells_whether_particles_were_drawn_anew(share, always):
    _, infos = driven([0.0, 0.5, 1.0], small(resample=share))
    assert [info.resampled for info in infos[1:]] == [always, always]
    assert not infos[0].resampled
    assert all(1.0 <= info.n_eff <= 6.0 for info in infos[1:])


def test_other_records_than_scans_and_empty_scans_move_nothing():
    cfg = small()
    state, _ = driven([0.0, 0.5], cfg)
    rng = np.random.default_rng(1)
    history, poses = len(state.history), state.poses
    same, info = step(state, Event(5.0, "r", Odometry(np.zeros(1), np.ones(1), np.zeros(1))), cfg, rng)
    assert info is None
    blind = replace(scan_at(np.array([2.0, 0.1, 0.05])), hit=np.zeros(90, bool))
    same, info = step(same, Event(6.0, "r", blind), cfg, rng)
    assert info.decision in {"empty", "odometry"}
    assert len(same.history) == history
    assert same.poses is poses


@pytest.mark.parametrize(("matched", "weighed", "moves"), [(10, 10, True), (100, 10, False), (10, 100, False)])
def test_a_scan_of_fewer_returns_than_matching_or_weighing_asks_for_moves_no_particle(
    monkeypatch, matched, weighed, moves
):
    monkeypatch.setattr(scan_odometry, "FRONT_END_LEAST_BEAMS", matched)
    monkeypatch.setattr(particle_slam, "FILTER_LEAST_BEAMS", weighed)
    state, infos = driven([0.0, 2.0], small())
    assert (infos[1].decision == "empty") == (matched == 100)
    assert len(state.history) == 1 + moves
    assert np.isfinite(infos[1].n_eff) == moves


def test_the_trajectory_goes_through_the_ancestors_of_the_likeliest_particle():
    cfg = small()
    state, _ = driven([0.0, 0.5, 1.0], cfg)
    P = len(state.poses)
    now = [np.tile([float(k), 0.0, 0.0], (P, 1)) + np.arange(P)[:, None] * [0.0, 0.1, 0.0] for k in range(3)]
    ancestors = [np.arange(P), np.array([3, 3, 3, 4, 4, 4]), np.array([5, 0, 1, 2, 0, 0])]
    state.history[:] = [(k, now[k], ancestors[k]) for k in range(3)]
    state.total = np.array([0.0, 1.0, 9.0, 2.0, 3.0, 8.0])  # particle 2, from 1, from 3
    np.testing.assert_allclose(trajectory(state), [[0, 0.3, 0], [1, 0.1, 0], [2, 0.2, 0]], atol=1e-9)


@pytest.mark.parametrize("gated", [True, False])
@pytest.mark.parametrize("decision", ["matched", "odometry"])
def test_only_a_gated_trajectory_whose_match_was_refused_is_not_refined(monkeypatch, gated, decision):
    cfg, rng, refined = small(), np.random.default_rng(0), []
    state = init("r", cfg, rng, gated=gated)
    assert len(state.poses) == (1 if gated else 6)
    advance = state.odometry.advance
    monkeypatch.setattr(state.odometry, "advance", lambda *of, **how: replace(advance(*of, **how), decision=decision))
    monkeypatch.setattr(particle_slam, "_refined", lambda s, *_: refined.append(1) or (s.poses, None))
    for k, x in enumerate((0.0, 1.0, 2.0)):
        state, _ = step(state, Event(float(k), "r", scan_at(np.array([x, 0.1, 0.05]))), cfg, rng)
    assert len(state.history) == 3
    assert len(refined) == (0 if gated and decision == "odometry" else 2)


@pytest.mark.parametrize("seed", range(4))
def test_what_lives_of_a_history_leads_every_particle_through_the_poses_it_came_by(seed):
    rng = np.random.default_rng(seed)
    whole = [(3 * k, rng.normal(size=(6, 3)), rng.integers(0, 6, 6) if k else np.arange(6)) for k in range(9)]
    whole[5] = (15, whole[5][1], np.arange(6))  # an update that drew nobody anew

    def ways(history):
        out = []
        for particle in range(6):
            way, at = [], particle
            for row, poses, ancestors in reversed(history):
                way.append((row, *poses[at]))
                at = int(ancestors[at])
            out.append(way)
        return np.array(out)

    kept = particle_slam.living(whole)
    np.testing.assert_array_equal(ways(kept), ways(whole))
    for (_, poses, _), later in pairwise(kept):
        assert set(range(len(poses))) == set(later[2].tolist())  # nobody is kept without a child
    np.testing.assert_array_equal(ways(particle_slam.living(kept)), ways(whole))
    assert particle_slam.living([]) == []


def test_particles_scatter_in_their_own_frames_as_far_as_the_way_says_and_a_single_one_does_not():
    cfg, rng = LaserConfig().filter, np.random.default_rng(3)
    poses = np.column_stack([rng.uniform(-5, 5, (4000, 2)), rng.uniform(-3, 3, 4000)])
    u = np.array([0.6, -0.8, 0.3])
    off = se2.between(poses, particle_slam.move(poses, u, cfg, rng)) - u
    sd = [cfg.sd_xy + cfg.sd_xy_per_m, cfg.sd_xy + cfg.sd_xy_per_m, cfg.sd_turn + cfg.sd_turn_per_m]
    np.testing.assert_allclose(off.std(axis=0), sd, rtol=0.06)
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=5 * max(sd) / np.sqrt(4000))
    alone = particle_slam.move(poses[:1], u, cfg, rng)
    np.testing.assert_allclose(se2.between(poses[0], alone[0]), u, atol=1e-12)


def test_the_latest_pose_is_the_likeliest_particles_and_as_sure_as_the_weighed_others_lie_round_it():
    cfg = small()
    state, _ = driven([0.0, 0.5], cfg)
    rng = np.random.default_rng(2)
    state.poses = np.column_stack([rng.normal(0, 1, (6, 2)), np.pi + rng.normal(0, 0.1, 6)])
    state.log_weight, state.total = rng.normal(0, 1, 6) - 700.0, rng.normal(0, 1, 6)
    told = particle_slam.current(state)
    best, share = int(np.argmax(state.total)), np.exp(state.log_weight + 700.0)
    off = state.poses - state.poses[best]
    off[:, 2] = se2.wrap_angle(off[:, 2])
    wanted = sum(s * np.outer(o, o) for s, o in zip(share / share.sum(), off, strict=True))
    np.testing.assert_allclose(se2.between(state.poses[best], told.pose), 0.0, atol=1e-12)
    np.testing.assert_allclose(told.cov, wanted, atol=1e-12)
    nothing = particle_slam.current(init("r", cfg, rng, feature="none"))
    assert not nothing.pose.any()
    assert not nothing.cov.any()


def test_what_a_scan_adds_is_added_to_the_weights_and_to_what_was_inherited(monkeypatch):
    cfg = small()
    state, _ = driven([0.0, 0.5], cfg)
    state.log_weight, state.total = np.arange(6.0), 10.0 + np.arange(6.0)
    gain = np.array([0.0, -1.0, -2.0, 0.0, -0.5, -4.0])
    monkeypatch.setattr(particle_slam, "log_likelihood", lambda D, c, feature: (gain, 33))
    weight, total, matches = _weighed(state, np.zeros((4, 3), np.float32), cfg)
    np.testing.assert_allclose(weight, np.arange(6.0) + gain)
    np.testing.assert_allclose(total, 10.0 + np.arange(6.0) + gain)
    assert matches == 33


@pytest.mark.parametrize(("log_weight", "due"), [(np.zeros(6), False), (np.array([0.0, -9, -9, -9, -9, -9]), True)])
def test_particles_are_drawn_anew_when_few_of_them_count(log_weight, due):
    cfg = small()
    state, _ = driven([0.0, 0.5], cfg)
    state.log_weight, state.total = log_weight, np.arange(6.0)
    state.poses = np.arange(18.0).reshape(6, 3)
    before = state.poses
    n_eff, ancestors = _resampled(state, cfg, np.random.default_rng(2))
    assert n_eff == pytest.approx(effective(log_weight)[1])
    assert (n_eff <= cfg.resample * 6) == due
    np.testing.assert_array_equal(state.poses, before[ancestors])
    np.testing.assert_array_equal(state.total, ancestors.astype(float))
    if due:
        assert set(ancestors) == {0}
        assert not state.log_weight.any()
    else:
        assert ancestors.tolist() == list(range(6))


def test_a_single_particle_is_not_drawn_anew():
    cfg = small()
    state = init("r", cfg, np.random.default_rng(0), gated=True)
    assert len(state.poses) == 1
    assert _resampled(state, cfg, np.random.default_rng(0))[1].tolist() == [0]
    assert init("r", cfg, np.random.default_rng(0)).poses.shape == (6, 3)


@pytest.mark.parametrize(("proposal", "matching"), [("front end", True), ("odometry", False)])
def test_scans_steer_the_particles_only_where_the_proposal_says_so(proposal, matching):
    cfg = small()
    cfg = replace(cfg, filter=replace(cfg.filter, proposal=proposal))
    assert init("r", cfg, np.random.default_rng(0)).odometry.matching is matching


def test_a_cell_holds_the_weighted_mean_of_what_fell_into_it_and_forgets_beyond_the_most():
    points = [[1.02, 0.53, 0.2], [1.06, 0.58, 0.6], [-0.83, 0.07, 0.4]]
    cells = laid(points, [0.2, 0.6, 0.5])
    order = np.argsort(cells[:, 0])
    np.testing.assert_allclose(cells[order], [[-0.83, 0.07, 0.4, 0.5], [1.05, 0.5675, 0.5, 0.8]], atol=1e-6)
    most = MOST_WEIGHT
    twice = laid([[1.02, 0.53, 0.2]], [0.3 * most], 2)
    np.testing.assert_allclose(twice[0, 3], 0.6 * most, rtol=1e-6)
    often = laid([[1.02, 0.53, 0.2]], [0.3 * most], 5)
    np.testing.assert_allclose(often[0, 3], most, rtol=1e-6)


def test_maps_turn_and_move_with_their_particles():
    grid = ParticleGrid(2, CELLS)
    poses = np.array([[0.5, -0.25, 0.0], [1.0, 2.0, 0.5 * np.pi]])
    points = np.array([[0.73, 0.12, 0.3]], np.float32)
    grid.insert(np.arange(2), poses, points, np.ones(1, np.float32))
    for k in range(2):
        np.testing.assert_allclose(grid.cells(k)[0, :2], se2.act(poses[k], points[0, :2]), atol=1e-6)
