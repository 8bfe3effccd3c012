"""Joining Cartesian maps equals dense algebra, tells its own error, and depends on nothing it should not."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion import full_covariance
from mapweave.fusion.cluster import Cluster
from mapweave.fusion.full_covariance import MapTerm, build, join
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.solve import Pattern, SolveConfig, minimise

from .worlds import covariance, team

QUICK = SolveConfig(max_iterations=4, damping=0.0, step_tolerance=1e-5)


def cluster_of(maps, points, frames):
    """A start at the truth: everything that every map holds."""
    ids = tuple(dict.fromkeys(name for m in maps for name in m.ids))
    places = np.array([points[int(name) - 100] for name in ids])
    return Cluster(tuple(range(len(maps))), frames, ids, places, np.array([len(m) for m in maps]))


def world(rng, **how):
    local, points, frames, scales = team(rng, **how)
    maps = [m.submap.landmarks for m in local]
    return maps, cluster_of(maps, points, frames), points, scales


def test_the_normal_equations_of_a_map_are_those_of_its_numeric_jacobian():
    rng = np.random.default_rng(1)
    n = 5
    V = covariance(rng, rng.normal(size=(n, 2)), (0.1, 0.5))
    term = MapTerm(np.arange(4 + 2 * n), rng.normal(size=2 * n), np.linalg.inv(V))
    x = np.concatenate([[0.3, -0.5, 2.1, 1.03], rng.normal(size=2 * n)])
    columns = []
    for k in range(len(x)):
        d = np.zeros(len(x))
        d[k] = 1e-6
        columns.append((term.residual(x + d) - term.residual(x - d)) / 2e-6)
    J, A, r = np.stack(columns, axis=1), term.information, term.residual(x)
    H, g = term.normal(x)
    np.testing.assert_allclose(H[0], J.T @ A @ J, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(g[0], J.T @ A @ r, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(term.jacobian(x), J, atol=1e-7)
    assert term.squares(x)[0] == pytest.approx(r @ A @ r)


def test_joining_equals_dense_weighted_least_squares():
    rng = np.random.default_rng(2)
    maps, start, _, _ = world(rng, robots=3, landmarks=8, seen=6)
    joined = join(maps, start)
    problem, layout = build(maps, start, [m.cov for m in maps], None)
    free = problem.free
    x = problem.x0.copy()
    V = np.zeros((36, 36))
    for k, m in enumerate(maps):
        V[12 * k : 12 * k + 12, 12 * k : 12 * k + 12] = m.cov
    terms = [t for t in problem.terms if isinstance(t, MapTerm)]

    def residual(x):
        return np.concatenate([t.residual(x) for t in terms])

    for _ in range(20):
        J = np.stack([(residual(x + 1e-6 * u) - residual(x - 1e-6 * u)) / 2e-6 for u in np.eye(len(x))[free]], axis=1)
        N = J.T @ np.linalg.solve(V, J)
        x[free] -= np.linalg.solve(N, J.T @ np.linalg.solve(V, residual(x)))
    np.testing.assert_allclose(joined.mean.ravel(), x[layout.landmarks :], atol=1e-6)
    np.testing.assert_allclose(joined.frames[:, :2].ravel(), x[:9].reshape(3, 3)[:, :2].ravel(), atol=1e-6)
    P = np.linalg.inv(N)[-2 * len(joined.ids) :, -2 * len(joined.ids) :]
    np.testing.assert_allclose(joined.cov, P, rtol=1e-4, atol=1e-9)
    assert joined.dof == 36 - 6 - 16


def test_scales_are_held_at_one_or_pulled_to_it_by_their_deviation():
    maps, start, _, _ = world(np.random.default_rng(3), robots=3, landmarks=8, seen=6)
    covariances = [m.cov for m in maps]
    held, _ = build(maps, start, covariances, None)
    free, layout = build(maps, start, covariances, 0.02)
    scales = 3 * 3 + np.arange(3)
    assert not set(scales) & set(held.free)
    assert set(free.free) == set(held.free) | set(scales)
    (prior,) = (t for t in free.terms if not isinstance(t, MapTerm))
    x = free.x0.copy()
    assert not prior.squares(x).any()
    x[scales] = [1.02, 0.94, 1.0]
    np.testing.assert_allclose(prior.squares(x), [1.0, 9.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(prior.normal(x)[0][:, 0, 0], 0.02**-2.0)
    np.testing.assert_allclose(prior.normal(x)[1][:, 0], (x[scales] - 1.0) / 0.02**2)
    assert layout.size == len(x)
    tight, _ = build(maps, start, covariances, 1e-7)
    np.testing.assert_allclose(minimise(tight).x, minimise(held).x, atol=1e-5)


@pytest.mark.slow
def test_the_error_a_full_join_states_is_the_error_it_makes():
    total, dof = 0.0, 0
    for place in range(8):  # eight teams, each mapped 250 times
        rng = np.random.default_rng([3, place])
        maps, start, points, _ = world(rng, robots=3, landmarks=6, seen=5, sigma=(0.002, 0.02))
        covs = [m.cov for m in maps]
        problem, layout = build(maps, start, covs, None)
        pattern = Pattern.of(problem)
        true = np.array([points[int(name) - 100] for name in start.ids]).ravel()
        exact = [t.z + t.residual(problem.x0) for t in problem.terms]
        roots = [np.linalg.cholesky(V) for V in covs]
        for _ in range(250):
            terms = [
                replace(t, z=z + L @ rng.normal(size=len(z)))
                for t, z, L in zip(problem.terms, exact, roots, strict=True)
            ]
            solution = minimise(replace(problem, terms=terms), QUICK, pattern)
            e = solution.x[layout.landmarks :] - true
            P = solution.covariance(np.arange(layout.landmarks, layout.size))
            total += float(e @ np.linalg.solve(P, e))
            dof += len(e)
    assert 0.98 <= total / dof <= 1.02


def test_the_scaled_join_finds_the_scale_of_each_map_and_states_its_error():
    total, dof, offs, sigmas = 0.0, 0, [], []
    for draw in range(40):
        rng = np.random.default_rng([4, draw])
        maps, start, points, scales = world(rng, robots=4, landmarks=12, seen=9, scale_sigma=0.02, sigma=(0.005, 0.02))
        joined = join(maps, start, scale_sigma=0.02, floor=0.001, variance_prior=4.0)
        e = (joined.mean - np.array([points[int(name) - 100] for name in joined.ids])).ravel()
        total += float(e @ np.linalg.solve(joined.cov, e))
        dof += len(e)
        ratio = joined.scales / joined.scales[0]
        offs.append(np.abs(ratio - scales / scales[0]).max())
        sigmas.append(np.abs(scales / scales[0] - 1).max())
    assert 0.85 <= total / dof <= 1.25
    assert np.mean(offs) < 0.25 * np.mean(sigmas)


def test_a_map_that_is_surer_than_it_should_be_is_given_a_larger_variance():
    factors = []
    for draw in range(12):
        rng = np.random.default_rng([5, draw])
        maps, start, _, _ = world(rng, robots=5, landmarks=15, seen=15)
        proud = LandmarkMap(maps[2].ids, maps[2].mean, maps[2].cov / 16, maps[2].frame)
        joined = join([*maps[:2], proud, *maps[3:]], start, variance_prior=1.0)
        factors.append(joined.variance_factors)
    middle = np.median(factors, axis=0)
    assert 8 < middle[2] < 24
    assert (np.delete(middle, 2) < 1.6).all()
    assert (np.delete(middle, 2) > 0.6).all()


def test_a_map_turned_in_its_own_frame_gives_the_same_landmarks():
    rng = np.random.default_rng(6)
    maps, start, _, _ = world(rng)
    turned = maps[1].moved(se2.pose(3.0, -2.0, 2.5), "other")
    frames = start.frames.copy()
    frames[1] = se2.compose(frames[1], se2.inverse(se2.pose(3.0, -2.0, 2.5)))
    again = join([maps[0], turned, *maps[2:]], Cluster(start.members, frames, start.ids, start.points, start.shared))
    once = join(maps, start)
    np.testing.assert_allclose(again.mean, once.mean, atol=1e-6)
    np.testing.assert_allclose(again.cov, once.cov, rtol=1e-4, atol=1e-8)


def test_sampled_variance_factors_are_the_exact_ones(monkeypatch):
    rng = np.random.default_rng(7)
    maps, start, _, _ = world(rng, robots=6, landmarks=40, seen=30, scale_sigma=0.01)
    maps[2] = LandmarkMap(maps[2].ids, maps[2].mean, maps[2].cov / 9, maps[2].frame)
    how = {"scale_sigma": 0.02, "floor": 0.002, "variance_prior": 4.0}
    exact = join(maps, start, **how)
    monkeypatch.setattr(full_covariance, "EXACT", 0)
    sampled = join(maps, start, **how)
    np.testing.assert_allclose(sampled.variance_factors, exact.variance_factors, rtol=0.12)
    np.testing.assert_allclose(sampled.mean, exact.mean, atol=0.005)


@pytest.mark.parametrize(("stated", "factor"), [(1e-6, 400.0), (1e6, 0.05)])
def test_a_variance_factor_is_believed_within_its_bounds_only(stated, factor):
    """A map that claims a thousandth, or a thousand times, of its error is a map out of bounds."""
    rng = np.random.default_rng(8)
    maps, start, _, _ = world(rng, robots=5, landmarks=15, seen=15)
    maps[2] = LandmarkMap(maps[2].ids, maps[2].mean, stated * maps[2].cov, maps[2].frame)
    joined = join(maps, start, scale_sigma=0.02, floor=1e-6, variance_prior=1e-6)
    assert joined.variance_factors[2] == factor
    assert np.all((joined.variance_factors > 0.05) & (joined.variance_factors < 400.0) | (np.arange(5) == 2))
