"""The minimiser equals dense linear algebra, keeps its promises, and agrees with GTSAM."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.solve import Cauchy, Factor, GemanMcClure, Huber, Pattern, Problem, SolveConfig, SolveStatus, minimise

from ..differences import assert_derivative, jacobian
from .problems import as_problem, pose_landmark_world


def random_linear(rng, n=30, m=80, k=2, d=5):
    """A random linear problem, and its dense matrix and right side."""
    columns = np.stack([rng.choice(n, d, replace=False) for _ in range(m)])
    A, b = rng.normal(size=(m, k, d)), rng.normal(size=(m, k))
    W = np.triu(rng.normal(size=(m, k, k))) + 2 * np.eye(k)
    dense = np.zeros((m, k, n))
    for i in range(m):
        dense[i][:, columns[i]] = W[i] @ A[i]
    right = (W @ b[..., None])[..., 0]
    factor = Factor(
        columns=columns,
        residual=lambda x: (A @ x[columns][..., None])[..., 0] - b,
        jacobian=lambda _: A,
        rows=k,
        sqrt_info=W,
    )
    return factor, dense.reshape(m * k, n), right.ravel()


def test_a_linear_problem_is_solved_in_one_step_as_dense_least_squares_does():
    rng = np.random.default_rng(1)
    factor, A, b = random_linear(rng)
    solution = minimise(Problem(x0=np.zeros(30), terms=[factor]), SolveConfig(damping=0.0, max_iterations=1))
    expected, residual, *_ = np.linalg.lstsq(A, b, rcond=None)
    np.testing.assert_allclose(solution.x, expected, atol=1e-11)
    np.testing.assert_allclose(solution.chi2, residual[0], rtol=1e-11)
    assert solution.dof == 160 - 30


@pytest.mark.parametrize("damping", [5.0, 0.3])
def test_each_step_that_does_what_was_predicted_is_damped_a_third_as_much_as_the_one_before(damping):
    line = Factor(np.array([[0]]), lambda x: x[:, None] - 4.0, lambda _: np.ones((1, 1, 1)), 1, np.array([[2.0]]))
    limits = SolveConfig(damping=damping, max_iterations=6, step_tolerance=0.0, cost_tolerance=0.0)
    solution = minimise(Problem(np.zeros(1), [line]), limits)
    left, want = 4.0, [64.0]
    for k in range(6):
        by = damping / 3.0**k
        left *= by / (1.0 + by)
        want.append((2.0 * left) ** 2)
    np.testing.assert_allclose(solution.costs, want, rtol=1e-4)
    assert solution.x[0] == pytest.approx(4.0 - left)
    assert solution.iterations == 6


def test_steps_that_fail_are_damped_twice_then_four_then_eight_times_as_much():
    tried = []

    def residual(x):
        tried.append(float(x[0]))
        return np.where(x >= 3.0, 10.0 * x, 1e3)[:, None]  # every step is far worse

    jump = Factor(np.array([[0]]), residual, lambda _: 10.0 * np.ones((1, 1, 1)), 1)
    stuck = minimise(Problem(np.full(1, 3.0), [jump]), SolveConfig(damping=1.0, max_iterations=5, step_tolerance=0.0))
    assert stuck.x[0] == 3.0
    steps = [3.0 - x for x in tried if x < 3.0]
    damping, wanted = 1.0, []
    for k in range(len(steps)):
        wanted.append(3.0 / (1.0 + damping))
        damping *= 2.0 ** (k + 1)
    assert len(steps) == 5
    np.testing.assert_allclose(steps, wanted, rtol=1e-9)


def test_marginals_equal_the_dense_inverse():
    rng = np.random.default_rng(2)
    factor, A, _ = random_linear(rng)
    info = minimise(Problem(x0=np.zeros(30), terms=[factor])).information
    P = np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(info.covariance(), P, atol=1e-12)
    index = np.array([[3, 7, 20], [0, 29, 5]])
    np.testing.assert_allclose(info.blocks(index), P[index[:, :, None], index[:, None, :]], atol=1e-12)
    np.testing.assert_allclose(info.covariance(np.array([4, 2])), P[np.ix_([4, 2], [4, 2])], atol=1e-12)
    np.testing.assert_allclose(info.logdet(), np.linalg.slogdet(A.T @ A)[1], rtol=1e-12)


def test_fixed_entries_keep_their_value_and_condition_the_rest():
    rng = np.random.default_rng(3)
    factor, A, b = random_linear(rng)
    x0, fixed = rng.normal(size=30), np.zeros(30, dtype=bool)
    fixed[[0, 11, 12]] = True
    solution = minimise(Problem(x0=x0, terms=[factor], fixed=fixed))
    expected = np.linalg.lstsq(A[:, ~fixed], b - A[:, fixed] @ x0[fixed], rcond=None)[0]
    np.testing.assert_array_equal(solution.x[fixed], x0[fixed])
    np.testing.assert_allclose(solution.x[~fixed], expected, atol=1e-10)
    P = solution.covariance()
    np.testing.assert_allclose(P[np.ix_(~fixed, ~fixed)], np.linalg.inv(A[:, ~fixed].T @ A[:, ~fixed]), atol=1e-12)
    assert not P[fixed].any()
    index = np.array([[0, 1], [12, 20]])
    np.testing.assert_allclose(solution.blocks(index), P[index[:, :, None], index[:, None, :]], atol=1e-12)


def test_a_variable_named_twice_in_one_factor_gets_the_sum_of_its_columns():
    factor = Factor(
        columns=np.array([[0, 0]]),
        residual=lambda x: 2 * x[None, :1] - 6,
        jacobian=lambda _: np.array([[[1.5, 0.5]]]),
        rows=1,
    )
    assert minimise(Problem(x0=np.zeros(1), terms=[factor])).x == pytest.approx(3.0, abs=1e-9)


def test_blocks_by_nested_dissection_are_those_of_the_inverse():
    rng = np.random.default_rng(6)
    solution = minimise(as_problem(*pose_landmark_world(rng, poses=90), rng))
    index = np.arange(270).reshape(90, 3)
    group = np.arange(len(solution.x)) + 90
    group[index] = np.arange(90)[:, None]
    along = np.full((len(group), 1), 45.0)  # landmarks in the middle: every cut along the drive leaves them
    along[index, 0] = np.arange(90)[:, None]
    plain = solution.blocks(index)
    for where in (None, along):
        apart = solution.dissected(group, where)
        assert apart.information.factor.together(index[1:] - 3)
        np.testing.assert_allclose(apart.blocks(index), plain, rtol=1e-8, atol=1e-13)
    assert not plain[0].any()  # the gauge
    assert np.linalg.eigvalsh(plain[1:]).min() > 0


def test_the_analytic_jacobians_of_the_shared_problem_are_the_numeric_ones():
    rng = np.random.default_rng(5)
    problem = as_problem(*pose_landmark_world(rng), rng)
    for factor in problem.terms:
        assert_derivative(factor, problem.x0, 1e-7)


def test_a_bad_start_converges_with_damping_to_the_same_minimum():
    rng = np.random.default_rng(6)
    world = pose_landmark_world(rng)
    near = minimise(as_problem(*world, rng, start_noise=0.01), SolveConfig(damping=0.0))
    far = minimise(as_problem(*world, rng, start_noise=0.6), SolveConfig(damping=1e-2, max_iterations=100))
    assert near.status is SolveStatus.CONVERGED
    assert far.status is SolveStatus.CONVERGED
    assert all(b <= a * (1 + 1e-9) for a, b in zip(far.costs, far.costs[1:], strict=False))
    np.testing.assert_allclose(far.x, near.x, atol=1e-7)


@pytest.mark.parametrize("start", [1.3930, 1.3945, -1.4])
def test_a_step_that_goes_uphill_by_less_than_a_hundredth_is_not_taken(start):
    # a full step on arctan(x) from a little beyond 1.39175 ends as far beyond on the other side
    full = start - np.arctan(start) * (1 + start**2)
    assert 1.0 < (np.arctan(full) / np.arctan(start)) ** 2 < 1.01
    factor = Factor(
        columns=np.array([[0]]),
        residual=lambda x: np.arctan(x)[None, :],
        jacobian=lambda x: (1 / (1 + x**2))[None, :, None],
        rows=1,
    )
    solution = minimise(Problem(x0=np.array([start]), terms=[factor]))
    assert solution.converged
    assert abs(solution.x[0]) < 1e-6
    assert all(b < a for a, b in zip(solution.costs, solution.costs[1:], strict=False))


def test_the_order_of_the_terms_does_not_matter():
    rng = np.random.default_rng(7)
    problem = as_problem(*pose_landmark_world(rng), rng)
    turned = Problem(x0=problem.x0, terms=problem.terms[::-1], fixed=problem.fixed, retract=problem.retract)
    np.testing.assert_allclose(minimise(turned).x, minimise(problem).x, atol=1e-9)


def test_a_pattern_may_be_used_again_for_the_same_structure():
    rng = np.random.default_rng(8)
    problem = as_problem(*pose_landmark_world(rng), rng)
    pattern = Pattern.of(problem)
    np.testing.assert_array_equal(minimise(problem, pattern=pattern).x, minimise(problem).x)


def test_a_free_gauge_is_said_to_be_singular_and_not_raised():
    factor = Factor(
        columns=np.array([[0, 1]]),
        residual=lambda x: (x[None, 1:] - x[None, :1]) - 1,
        jacobian=lambda _: np.array([[[-1.0, 1.0]]]),
        rows=1,
    )
    gauss_newton = minimise(Problem(x0=np.zeros(2), terms=[factor]), SolveConfig(damping=0.0))
    assert gauss_newton.status is SolveStatus.SINGULAR
    damped = minimise(Problem(x0=np.zeros(2), terms=[factor]))
    assert damped.converged
    assert damped.x[1] - damped.x[0] == pytest.approx(1.0, abs=1e-9)


def test_a_cost_that_is_not_a_number_ends_as_a_status():
    factor = Factor(
        columns=np.array([[0]]),
        residual=lambda x: np.where(x > 0, x - 1, np.nan)[None, :],
        jacobian=lambda x: np.where(x > 0, 1.0, np.nan)[None, :, None] * -5.0,
        rows=1,
    )
    solution = minimise(Problem(x0=np.array([2.0]), terms=[factor]), SolveConfig(damping=0.0))
    assert solution.status in {SolveStatus.DIVERGED, SolveStatus.CONVERGED, SolveStatus.MAX_ITERATIONS}
    assert np.isfinite(solution.x).all()


@pytest.mark.parametrize("kernel", [Huber(1.0), Cauchy(2.0), GemanMcClure(3.0)])
def test_a_robust_kernel_is_square_near_zero_and_its_weight_is_its_slope(kernel):
    s = np.array([1e-8, 0.3, 2.0, 30.0, 1e4])
    h = 1e-6 * s
    slope = (kernel.cost(s + h) - kernel.cost(s - h)) / (2 * h)
    np.testing.assert_allclose(kernel.weight(s), slope, rtol=1e-5)
    assert kernel.cost(s)[0] == pytest.approx(s[0], rel=1e-6)
    assert (np.diff(kernel.cost(s)) > 0).all()
    bend = kernel.k**2 * np.array([1 - 1e-9, 1 + 1e-9])
    assert np.ptp(kernel.cost(bend)) < 1e-6
    fading = -s * (kernel.weight(s + h) - kernel.weight(s - h)) / (2 * h)
    np.testing.assert_allclose(kernel.fading(s), fading, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("kernel", [None, Huber(1.0), Cauchy(1.0)])
@pytest.mark.parametrize("rows", [2, 3])
def test_the_curvature_of_a_factor_is_the_mean_second_derivative_of_its_costs(kernel, rows):
    x = np.random.default_rng(2).normal(size=200 * rows)
    columns = np.arange(len(x)).reshape(-1, rows)
    unit = np.broadcast_to(np.eye(rows), (200, rows, rows))
    factor = Factor(columns, lambda x: x[columns], lambda _: unit, rows, kernel=kernel)
    h, curved = 1e-4, 0.0
    for k in range(rows):
        step = np.zeros(len(x))
        step[columns[:, k]] = h
        ahead, behind = (factor.costs(x + d).sum() for d in (step, -step))
        curved += (ahead + behind - 2 * factor.costs(x).sum()) / (2 * h * h)
    told = np.einsum("mii->", factor.normal(x)[0])
    assert factor.curvature(x) == pytest.approx(curved / told, rel=1e-3)
    assert (factor.curvature(x) < 0.9) == (kernel is not None)


@pytest.mark.parametrize("kernel", [Huber(), Cauchy()])
def test_a_robust_kernel_as_it_comes_keeps_95_percent_of_the_efficiency_where_noise_is_normal(kernel):
    # asymptotic efficiency of the location estimate with psi(r) = r weight(r^2): E[psi']^2 / E[psi^2]
    r = np.linspace(-12.0, 12.0, 48001)
    density = np.exp(-0.5 * r**2) / np.sqrt(2 * np.pi)
    psi = r * kernel.weight(r**2)
    slope = np.gradient(psi, r)
    efficiency = np.trapezoid(slope * density, r) ** 2 / np.trapezoid(psi**2 * density, r)
    assert efficiency == pytest.approx(0.95, abs=5e-4)


@pytest.mark.parametrize("kernel", [Huber(1.0), Cauchy(2.0), GemanMcClure(3.0)])
def test_a_robust_kernel_shrugs_off_gross_outliers(kernel):
    rng = np.random.default_rng(9)
    truth, points, odometry, (a, b, seen) = pose_landmark_world(rng)
    clean = minimise(as_problem(truth, points, odometry, (a, b, seen), rng, start_noise=0.01))
    seen = seen.copy()
    seen[::12, 0] += 3.0
    plain = minimise(as_problem(truth, points, odometry, (a, b, seen), rng, start_noise=0.01))
    robust = minimise(as_problem(truth, points, odometry, (a, b, seen), rng, kernel, start_noise=0.01))
    assert robust.converged
    points = slice(3 * len(truth), None)
    assert np.abs(robust.x - clean.x)[points].max() < 0.5 * np.abs(plain.x - clean.x)[points].max()
    assert robust.cost < robust.chi2


def test_the_minimum_and_its_covariance_are_those_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    rng = np.random.default_rng(10)
    truth, points, odometry, sightings = pose_landmark_world(rng)
    problem = as_problem(truth, points, odometry, sightings, rng)
    ours = minimise(problem, SolveConfig(step_tolerance=1e-12))
    n = len(truth)
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*truth[0]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.05, 0.02]))
    for i, j, z in zip(*odometry, strict=True):
        # GTSAM's between residual is the logarithm; ours is the plain difference. A custom factor says ours.
        def error(_, values, H, i=int(i), j=int(j), z=z):
            p, q = (np.array([v.x(), v.y(), v.theta()]) for v in (values.atPose2(i), values.atPose2(j)))
            r = se2.between(p, q) - z
            r[2] = se2.wrap_angle(r[2])
            if H is not None:
                for k, (base, at) in enumerate(((p, i), (q, j))):

                    def moved(d, at=at, base=base):
                        new = se2.compose(base, se2.exp(d))
                        other = se2.between(new, q) if at == i else se2.between(p, new)
                        return other - z

                    H[k] = np.asfortranarray(jacobian(moved, np.zeros(3)))
            return r

        graph.add(gtsam.CustomFactor(noise, [int(i), int(j)], error))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.03, 0.1]))
    for a, b, z in zip(*sightings, strict=True):
        graph.add(gtsam.BearingRangeFactor2D(int(a), 100 + int(b), gtsam.Rot2(z[1]), z[0], noise))
    for k in range(n):
        start.insert(k, gtsam.Pose2(*problem.x0[3 * k : 3 * k + 3]))
    for k in range(len(points)):
        start.insert(100 + k, problem.x0[3 * n + 2 * k : 3 * n + 2 * k + 2])
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    theirs = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    marginals = gtsam.Marginals(graph, theirs)
    for k in range(len(points)):
        at = 3 * n + 2 * k
        np.testing.assert_allclose(ours.x[at : at + 2], theirs.atPoint2(100 + k), atol=1e-5)
        block = ours.information.covariance(np.arange(at, at + 2) - 3)
        np.testing.assert_allclose(block, marginals.marginalCovariance(100 + k), rtol=1e-3)


def test_ten_thousand_robots_in_a_plane_are_one_sparse_problem():
    rng = np.random.default_rng(11)
    side = 60
    truth = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2).astype(float)
    k = np.arange(side * side).reshape(side, side)
    i = np.concatenate([k[:, :-1].ravel(), k[:-1].ravel()])
    j = np.concatenate([k[:, 1:].ravel(), k[1:].ravel()])
    z = truth[j] - truth[i] + rng.normal(0, 0.01, (len(i), 2))
    two = np.arange(2)
    J = np.tile(np.concatenate([-np.eye(2), np.eye(2)], axis=1)[None], (len(i), 1, 1))
    factor = Factor(
        columns=np.concatenate([2 * i[:, None] + two, 2 * j[:, None] + two], axis=1),
        residual=lambda x: x.reshape(-1, 2)[j] - x.reshape(-1, 2)[i] - z,
        jacobian=lambda _: J,
        rows=2,
        sqrt_info=np.full((1, 2), 100.0),
    )
    fixed = np.zeros(2 * side * side, dtype=bool)
    fixed[:2] = True
    solution = minimise(Problem(x0=np.zeros(2 * side * side), terms=[factor], fixed=fixed))
    assert solution.converged
    assert np.sqrt(np.mean((solution.x - truth.ravel()) ** 2)) < 0.1
    assert solution.information.factor_bytes < 20e6
