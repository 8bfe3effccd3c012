"""Two maps laid over each other with both covariances whole, against dense least squares, and rigid fits that survive
wrong points."""

from itertools import combinations, permutations

import numpy as np
import pytest
from scipy.optimize import least_squares

from mapweave.core import se2
from mapweave.fusion import alignment
from mapweave.fusion.alignment import _Linked, align_robust, joint_fit
from mapweave.landmarks.landmark_map import LandmarkMap

from .worlds import covariance

NOISE, SCALE = 0.02, 0.03


def pair(seed, n=7):
    """Two maps of one place with correlated errors, one turned by T and 4 % too large; links in mixed order."""
    rng = np.random.default_rng([seed, 60])
    T = np.array([2.0, -3.0, 2.5])
    points = rng.uniform(-4, 4, (n, 2))
    maps = []
    for at in (points, 1.04 * se2.act(T, points)):
        P = covariance(rng, at, (0.02, 0.2))
        noise = (np.linalg.cholesky(P) @ rng.normal(size=2 * n)).reshape(-1, 2)
        maps.append(LandmarkMap(tuple(map(str, range(n))), at + noise, P))
    shuffled = rng.permutation(n)
    source = LandmarkMap(maps[0].ids, maps[0].mean, maps[0].cov)
    order = (2 * shuffled[:, None] + np.arange(2)).ravel()
    target = LandmarkMap(maps[1].ids, maps[1].mean[shuffled], maps[1].cov[np.ix_(order, order)])
    links = np.stack([shuffled, np.arange(n)], axis=1)[: n - 1]
    return source, target, links, T


def whitened(x, at, source, target, links):
    """Residuals whitened at heading `at`, and the prior of the scale."""
    R = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]])
    a, b = ((2 * links[:, [c]] + np.arange(2)).ravel() for c in (0, 1))
    C = np.kron(np.eye(len(links)), R)
    V = C @ source.cov[np.ix_(a, a)] @ C.T + target.cov[np.ix_(b, b)] + 2 * NOISE**2 * np.eye(len(a))
    r = (x[3] * se2.act(np.array([0, 0, x[2]]), source.mean[links[:, 0]]) + x[:2] - target.mean[links[:, 1]]).ravel()
    return np.append(np.linalg.solve(np.linalg.cholesky(V), r), (x[3] - 1.0) / SCALE)


def dense(source, target, links, T):
    x = np.append(T, 1.0)
    for _ in range(30):
        x = least_squares(whitened, x, args=(x[2], source, target, links), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    return x, float(np.square(whitened(x, x[2], source, target, links)).sum())


@pytest.mark.parametrize("seed", range(4))
def test_the_fit_is_the_least_squares_one_with_the_sources_covariance_turned(seed):
    source, target, links, T = pair(seed)
    fit = joint_fit(source, target, links, T + np.array([0.1, -0.1, 0.05]), NOISE, SCALE)
    x, cost = dense(source, target, links, T)
    np.testing.assert_allclose(np.append(fit.T, fit.scale), x, atol=2e-5)
    assert fit.chi2 == pytest.approx(cost, rel=1e-5)
    assert abs(fit.scale - 1.0) > 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_what_a_link_alone_adds_is_what_chi_square_loses_without_it(seed):
    """To first order, with the covariances turned as they were."""
    source, target, links, T = pair(seed)
    fit = joint_fit(source, target, links, T, NOISE, SCALE)
    x = np.append(fit.T, fit.scale)
    A, r, J = _Linked(source, target, links, NOISE, SCALE).linearised(x)
    n = 2 * len(links)
    V = np.zeros((n + 1, n + 1))
    V[:n, :n], V[n, n] = np.linalg.inv(A), SCALE**2
    r, J = np.append(r, fit.scale - 1.0), np.vstack([J, [0.0, 0.0, 0.0, 1.0]])
    for k in range(len(links)):
        costs = []
        for rows in (np.arange(n + 1), np.delete(np.arange(n + 1), [2 * k, 2 * k + 1])):
            W = np.linalg.inv(V[np.ix_(rows, rows)])
            H, g = J[rows].T @ W @ J[rows], J[rows].T @ W @ r[rows]
            costs.append(r[rows] @ W @ r[rows] - g @ np.linalg.solve(H, g))
        assert fit.single[k] == pytest.approx(costs[0] - costs[1], rel=1e-3, abs=1e-3)


def test_the_normal_equations_are_those_of_the_numeric_jacobian():
    source, target, links, T = pair(9)
    linked = _Linked(source, target, links, NOISE, SCALE)
    x = np.append(T + 0.1, 1.1)
    A, r, J = linked.linearised(x)
    h = 1e-6
    numeric = [(linked.linearised(x + h * u)[1] - linked.linearised(x - h * u)[1]) / (2 * h) for u in np.eye(4)]
    np.testing.assert_allclose(J, np.stack(numeric, axis=1), atol=1e-7)
    H, g, cost = linked.normal(x)
    prior = np.diag([0.0, 0.0, 0.0, SCALE**-2])
    np.testing.assert_allclose(H, J.T @ A @ J + prior)
    np.testing.assert_allclose(g, J.T @ A @ r + prior @ [0, 0, 0, 0.1])
    assert cost == pytest.approx(r @ A @ r + (0.1 / SCALE) ** 2)
    assert cost == pytest.approx(np.square(whitened(x, x[2], source, target, links)).sum())


def test_a_rigid_fit_is_exact_on_clean_points_and_unmoved_by_wrong_ones():
    rng = np.random.default_rng(0)
    T = np.array([1.0, 2.0, -2.8])
    source = rng.uniform(-5, 5, (11, 2))
    target = se2.act(T, source)
    wrong = [1, 4, 8, 9]
    target[wrong] += rng.uniform(2, 4, (4, 2))
    gate = np.full(11, 0.3)
    fit = align_robust(source, target, gate)
    np.testing.assert_allclose(fit.T_target_source, T, atol=1e-9)
    assert np.flatnonzero(~fit.inliers).tolist() == wrong
    np.testing.assert_allclose(fit.residual, np.hypot(*(target - se2.act(T, source)).T), atol=1e-9)
    assert fit.median == pytest.approx(0.0, abs=1e-9)


def test_a_rigid_fit_is_the_least_squares_one_over_its_inliers():
    rng = np.random.default_rng(1)
    source = rng.uniform(-5, 5, (30, 2))
    target = se2.act(np.array([0.0, -1.0, 1.3]), source) + 0.05 * rng.normal(size=(30, 2))
    target[:9] += 3.0
    fit = align_robust(source, target, np.full(30, 0.2))
    assert not fit.inliers[:9].any()
    assert fit.inliers[9:].sum() > 15
    np.testing.assert_allclose(fit.T_target_source, se2.align(source[fit.inliers], target[fit.inliers]), atol=1e-12)


def test_each_point_has_its_own_gate():
    source = np.array([[0.0, 0], [4, 0], [4, 3], [0, 3], [2, 5]])
    target = source + np.array([[0, 0], [0, 0], [0, 0], [0, 0], [0.4, 0.0]])
    tight = align_robust(source, target, np.array([0.1, 0.1, 0.1, 0.1, 0.1]))
    wide = align_robust(source, target, np.array([0.3, 0.3, 0.3, 0.3, 1.0]))
    assert tight.inliers.tolist() == [True] * 4 + [False]
    assert wide.inliers.all()


@pytest.mark.parametrize("n", [2, 34, 35, 36, 200, 5000])
def test_hypotheses_are_pairs_of_different_points_in_which_every_point_is_alike_often(n):
    i, j = alignment._pairs(n)
    assert (i != j).all()
    assert min(i.min(), j.min()) == 0
    assert max(i.max(), j.max()) == n - 1
    times = np.bincount(np.concatenate([i, j]), minlength=n)
    assert times.min() == times.max()
    if n * (n - 1) // 2 <= alignment.HYPOTHESES:
        assert len({tuple(sorted(p)) for p in zip(i.tolist(), j.tolist(), strict=True)}) == n * (n - 1) // 2
    else:
        assert 0.4 * alignment.HYPOTHESES <= len(i) <= max(alignment.HYPOTHESES, n)


def test_points_that_coincide_propose_no_turn_and_break_nothing():
    source = np.array([[0.0, 0], [0, 0], [3, 0], [0, 4]])
    T = np.array([1.0, 1.0, 0.7])
    fit = align_robust(source, se2.act(T, source), np.full(4, 0.1))
    np.testing.assert_allclose(fit.T_target_source, T, atol=1e-9)


@pytest.mark.parametrize("links", [3, 5])
def test_the_evidence_for_links_is_the_integral_over_every_transform_and_scale(links):
    rng = np.random.default_rng([links, 61])
    T, sd, area = np.array([2.0, -3.0, 2.5]), 0.04, 120.0
    points = rng.uniform(-4, 4, (links, 2))
    ids = tuple(map(str, range(links)))
    maps = [
        LandmarkMap(ids, p + sd * rng.normal(size=p.shape), sd**2 * np.eye(2 * links))
        for p in (points, se2.act(T, points))
    ]
    pairs = np.stack([np.arange(links)] * 2, axis=1)
    fit = joint_fit(*maps, pairs, T, NOISE, SCALE)
    variance = 2 * sd**2 + 2 * NOISE**2  # of a coordinate's difference, whatever the heading
    turned = maps[0].mean @ se2.rotation(float(fit.T[2])).T
    spread = np.sqrt(variance / np.array([links, np.square(turned - turned.mean(axis=0)).sum()]))
    steps = np.linspace(-7, 7, 57)
    turns, scales = fit.T[2] + spread[1] * steps, fit.scale + spread[1] * steps
    integral = 0.0
    for (
        heading
    ) in turns:  # the shift, of which there is one best for each heading and scale, is integrated in closed form
        at = scales[:, None, None] * (maps[0].mean @ se2.rotation(float(heading)).T)
        r = maps[1].mean - at
        chi2 = np.square(r - r.mean(axis=1, keepdims=True)).sum(axis=(1, 2)) / variance
        prior = np.exp(-0.5 * np.square((scales - 1) / SCALE)) / np.sqrt(2 * np.pi * SCALE**2)
        shift = 2 * np.pi * variance / links
        integral += float(np.sum(np.exp(-0.5 * chi2) * prior)) * shift / (2 * np.pi * variance) ** links
    integral *= (spread[1] * (steps[1] - steps[0])) ** 2 / (2 * np.pi * area)
    want = np.log(integral) + links * np.log(area)
    assert alignment.log_evidence(*maps, pairs, fit, area, NOISE, SCALE) == pytest.approx(want, abs=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_known_of_transform_and_scale_is_the_numeric_jacobian_weighed_with_both_covariances(seed):
    source, target, links, T = pair(seed)
    V, N = alignment._precision(source, target, links, T, NOISE, SCALE)
    x, h = np.append(T, 1.0), 1e-6
    J = [
        whitened(x + h * u, T[2], source, target, links) - whitened(x - h * u, T[2], source, target, links)
        for u in np.eye(4)
    ]
    J = np.stack(J, axis=1) / (2 * h)
    np.testing.assert_allclose(N, J.T @ J, rtol=1e-5, atol=1e-5 * np.abs(N).max())
    W = _Linked(source, target, links, NOISE, SCALE).linearised(x)[0]
    np.testing.assert_allclose(V @ W, np.eye(2 * len(links)), atol=1e-9)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (4, 4), (3, 5), (5, 2)])
def test_the_ways_in_which_landmarks_can_correspond_are_those_that_are_counted_one_by_one(n, m):
    for k in range(min(n, m) + 1):
        ways = sum(1 for _ in combinations(range(n), k) for _ in permutations(range(m), k))
        assert alignment.log_correspondences(k, n, m) == pytest.approx(np.log(ways), abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5, 300])
def test_the_area_of_landmarks_is_that_of_a_disc_spread_as_widely(n):
    at = np.linspace(0.0, 2 * np.pi, 6, endpoint=False)
    ring = np.stack([np.cos(at), np.sin(at)], axis=1)
    points = np.concatenate([np.sqrt((k + 0.5) / n) * ring for k in range(n)])
    m = LandmarkMap(tuple(map(str, range(6 * n))), 3.0 * points + [50.0, -70.0], np.eye(12 * n))
    assert alignment.spread_area(m) == pytest.approx(9 * np.pi, rel=1e-9)  # a disc of 3 m in rings of equal area
