"""Any pose graph solved: against dense algebra and GTSAM, with false closures, in parts, with priors."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy import stats

from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.io.g2o import read_g2o
from mapweave.laser import robust_graph
from mapweave.laser.pose_graph import PoseGraph
from mapweave.laser.robust_graph import (
    FADED,
    Prior,
    RobustGraphConfig,
    connected,
    left_out_squares,
    solve_graph,
    truncated_weights,
)
from mapweave.solve.optimise import SolveConfig, minimise

from ..differences import jacobian

SD = np.array([0.05, 0.05, 0.02])
PLAIN = RobustGraphConfig(method="none")


def laps(rng, n=60, closures=40, every=20):
    """Rounds of a circle, `every` poses each, with measured steps and closures; starts from the steps."""
    turn = 2 * np.pi / every
    truth = np.stack(
        [5 * np.sin(turn * np.arange(n)), 5 - 5 * np.cos(turn * np.arange(n)), turn * np.arange(n)], axis=1
    )
    truth[:, 2] = se2.wrap_angle(truth[:, 2])
    a = rng.integers(0, n - 2, closures)
    b = a + 2 + rng.integers(0, n - 2 - a)
    pairs = [*((k, k + 1) for k in range(n - 1)), *zip(a.tolist(), b.tolist(), strict=True)]
    z = [se2.compose(se2.between(truth[i], truth[j]), rng.normal(0, SD)) for i, j in pairs]
    start = [truth[0]]
    for step in z[: n - 1]:
        start.append(se2.compose(start[-1], step))
    return truth, PoseGraph.of(np.array(start), pairs, z, [np.diag(SD**-2.0)] * len(pairs))


def with_false(graph, count, rng):
    n = len(graph)
    a = rng.integers(0, n // 2, count)
    b = a + rng.integers(2, n // 2, count)
    z = np.column_stack([rng.uniform(-8, 8, (count, 2)), rng.uniform(-3, 3, count)])
    pairs = list(zip(a.tolist(), b.tolist(), strict=True))
    return graph.joined(PoseGraph.of(graph.pose, pairs, list(z), [np.diag(SD**-2.0)] * count))


def squares(graph):
    r = se2.between(graph.measured, se2.between(graph.pose[graph.first], graph.pose[graph.second]))
    return np.einsum("mi,mij,mj->m", r, graph.information, r)


def test_the_optimum_has_no_slope_and_its_covariances_are_those_of_the_whole_inverse():
    _, graph = laps(np.random.default_rng(0), n=24, closures=12)
    solved = solve_graph(graph, PLAIN, fixed=[3])
    assert solved.converged
    assert solved.chi2 == pytest.approx(squares(solved.graph).sum())
    assert solved.chi2_before == pytest.approx(squares(graph).sum())
    x = solved.graph.pose.ravel()
    W = np.linalg.cholesky(graph.information).swapaxes(1, 2)

    def residual(v):
        p = v.reshape(-1, 3)
        return (W @ se2.between(graph.measured, se2.between(p[graph.first], p[graph.second]))[..., None]).ravel()

    J = jacobian(residual, x)
    free = np.setdiff1d(np.arange(len(x)), 3 * 3 + np.arange(3))
    assert np.abs(J[:, free].T @ residual(x)).max() < 1e-2
    P = np.zeros((len(x), len(x)))
    P[np.ix_(free, free)] = np.linalg.inv(J[:, free].T @ J[:, free])
    got = solved.covariances()
    for k in range(len(graph)):
        at = 3 * k + np.arange(3)
        assert np.allclose(got[k], P[np.ix_(at, at)], rtol=1e-4, atol=1e-9)
    a, b = np.array([2, 5]), np.array([9, 23])
    relative = solved.relative_covariances(a, b)
    for k in range(2):
        at = np.concatenate([3 * a[k] + np.arange(3), 3 * b[k] + np.arange(3)])

        def between(v):
            return se2.between(v[:3], v[3:])

        D = jacobian(between, x[at])
        assert np.allclose(relative[k], D @ P[np.ix_(at, at)] @ D.T, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("method", ["gnc", "cauchy"])
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_false_closures_are_dropped_and_told(method, share):
    for seed in range(4):
        rng = np.random.default_rng([seed, 1])
        _, graph = laps(rng)
        clean = solve_graph(graph, RobustGraphConfig(method=method))
        bad = with_false(graph, round(share * 40), rng)
        solved = solve_graph(bad, RobustGraphConfig(method=method))
        false = np.arange(bad.edges) >= graph.edges
        assert not solved.used[false].any()
        assert solved.rounds < robust_graph.MOST_ROUNDS
        assert solved.iterations >= solved.rounds
        assert {d.edge for d in solved.dropped} == set(np.flatnonzero(~solved.used).tolist())
        for d in solved.dropped:
            assert d.nis > 16.27
            assert (d.first, d.second) == (bad.first[d.edge], bad.second[d.edge])
            assert f"{np.sqrt(d.nis):.1f} standard deviations" in d.reason
            assert "the limit is 4.0" in d.reason
        assert clean.used.sum() >= graph.edges - 1
        cost = squares(replace(graph, pose=solved.graph.pose))[clean.used].sum()
        assert cost <= 1.05 * clean.chi2
        plain = solve_graph(bad, PLAIN)
        assert squares(replace(graph, pose=plain.graph.pose)).sum() > 10 * clean.chi2


@pytest.mark.parametrize("control", [0.01, 0.4, 3.0, 50.0])
def test_what_an_edge_counts_is_the_weight_of_least_cost_with_what_dropping_it_costs(control):
    gate = 16.27
    s = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 60)])
    found = truncated_weights(s, gate, control)
    w = np.linspace(0.0, 1.0, 20001)
    cost = w * s[:, None] + gate * control * (1 - w) / (control + w)
    np.testing.assert_allclose(found, np.maximum(w[cost.argmin(axis=1)], FADED), atol=1e-4)
    assert (np.diff(found) <= 0).all()
    assert found[0] == 1.0
    assert found[-1] == FADED
    high = (control + 1.0) / control * gate
    assert truncated_weights(np.array([high * (1 - 1e-12)]), gate, control)[0] >= FADED


@pytest.mark.parametrize(("weight", "ends"), [(1.0, True), (FADED, True), (0.5, False), (0.999, False)])
def test_weights_are_sought_until_every_edge_counts_whole_or_not_at_all(monkeypatch, weight, ends):
    rng = np.random.default_rng(2)
    _, graph = laps(rng, n=12, closures=4)
    bad = with_false(graph, 1, rng)
    held, may, cfg = (0,), np.arange(bad.edges) >= 11, RobustGraphConfig()
    monkeypatch.setattr(robust_graph, "MOST_ROUNDS", 60)
    monkeypatch.setattr(robust_graph, "truncated_weights", lambda s, *_: np.full(len(s), weight))
    rounds = robust_graph._believed(bad, cfg, held, (), may, np.ones(bad.edges, dtype=bool))[2]
    assert (rounds < 60) == ends
    assert rounds > 1 or weight == 1.0  # what they count has been solved with


def test_weights_that_are_found_are_those_of_the_truncated_cost_itself():
    gate = robust_graph.CONTRADICTION
    for seed in range(6):
        rng = np.random.default_rng([seed, 7])
        _, graph = laps(rng)
        bad = with_false(graph, 12, rng)
        may = np.arange(bad.edges) >= 29
        used, pose, _, _ = robust_graph._believed(bad, RobustGraphConfig(), (0,), (), may, np.ones(bad.edges, bool))
        weight = np.where(used, 1.0, FADED)
        again = minimise(
            robust_graph._problem(replace(bad, pose=pose), weight, (0,), (), None), SolveConfig(max_iterations=20)
        )
        s = squares(replace(bad, pose=again.x.reshape(-1, 3)))[may]
        assert (truncated_weights(s, gate, 20.0) == weight[may]).all()


@pytest.mark.parametrize("astray", ["what is given", "what the search for contradictions ends at"])
def test_of_the_minima_that_two_starts_lead_to_the_lower_is_taken(monkeypatch, astray):
    truth, graph = laps(np.random.default_rng(1), n=20, closures=0)
    ring = graph.joined(PoseGraph.of(graph.pose, [(19, 0)], [se2.between(truth[19], truth[0])], [np.diag(SD**-2.0)]))
    wound = truth.copy()
    wound[:, 2] += 2 * np.pi / 20 * np.arange(20)  # the headings go round once too often: a minimum of its own
    wound[:, 2] = se2.wrap_angle(wound[:, 2])
    given, found = (wound, truth) if astray == "what is given" else (truth, wound)
    all_of_them = np.ones(ring.edges, dtype=bool)
    monkeypatch.setattr(robust_graph, "_believed", lambda *_: (all_of_them, found, 1, 1))
    monkeypatch.setattr(robust_graph, "CONTRADICTION", 1e9)
    monkeypatch.setattr(robust_graph, "EDGE_CHANCE", 1e-300)
    solved = solve_graph(replace(ring, pose=given), RobustGraphConfig())
    monkeypatch.undo()
    plain = [solve_graph(replace(ring, pose=start), PLAIN).chi2 for start in (truth, wound)]
    assert plain[1] > 10 * plain[0]
    assert solved.chi2 == pytest.approx(plain[0], rel=1e-6)
    assert solved.used.all()


def test_without_a_search_for_contradictions_a_graph_is_solved_once():
    _, graph = laps(np.random.default_rng(1), n=24, closures=6)
    plain = solve_graph(graph, PLAIN)
    assert plain.iterations == plain.solution.iterations
    assert plain.rounds == 0
    searched = solve_graph(graph)
    assert searched.iterations > searched.solution.iterations


@pytest.mark.parametrize(
    ("edges", "scatter", "share", "dropped"),
    [
        (40, 1.0, 1.02, True),
        (40, 1.0, 0.98, False),
        (40, 3.0, 1.02, True),  # edges that scatter more than they say are no excuse
        (40, 0.05, 0.52, True),  # where they scatter less, less is a contradiction
        (40, 0.05, 0.48, False),
        (40, 1e-4, 0.12, True),
        (40, 1e-4, 0.08, False),  # to a tenth of what they say of themselves
        (20, 0.05, 0.52, False),  # too few to tell how they scatter
    ],
)
def test_the_edge_that_contradicts_all_others_most_is_dropped_beyond_what_chance_gives(
    monkeypatch, edges, scatter, share, dropped
):
    _, graph = laps(np.random.default_rng(1), n=12, closures=edges)
    solved = solve_graph(graph, PLAIN)
    asked = np.arange(graph.edges) >= 11
    nis = np.full(edges, scatter * stats.chi2.ppf(0.5, 3))
    nis[7] = share * stats.chi2.ppf(1 - 1e-3 / edges, 3)
    monkeypatch.setattr(robust_graph, "left_out_squares", lambda *_: nis)
    assert robust_graph._worst(graph, solved.solution, asked) == (11 + 7 if dropped else None)


def test_how_far_an_edge_lies_from_the_solution_without_it_is_what_solving_without_it_says():
    _, graph = laps(np.random.default_rng(3), n=24, closures=10)
    solved = solve_graph(graph, PLAIN)
    rows = np.arange(23, graph.edges)
    told = left_out_squares(solved.graph, solved.solution, rows)
    for row, square in zip(rows.tolist(), told.tolist(), strict=True):
        rest = np.arange(graph.edges) != row
        names = ("first", "second", "measured", "information")
        less = solve_graph(PoseGraph(graph.pose, *(getattr(graph, name)[rest] for name in names)), PLAIN)
        i, j = graph.first[[row]], graph.second[[row]]
        seen = se2.between(less.graph.pose[i], less.graph.pose[j])
        r = se2.between(graph.measured[[row]], seen)[0]
        P = less.relative_covariances(i, j)[0]
        turn = se2.turn(-graph.measured[row, 2])
        S = turn @ P @ turn.T + np.linalg.inv(graph.information[row])
        assert square == pytest.approx(r @ np.linalg.solve(S, r), rel=0.15, abs=0.05)


def test_a_false_closure_that_bends_the_graph_to_itself_is_found():
    truth, graph = laps(np.random.default_rng(8), n=40, closures=6)
    z = se2.compose(se2.between(truth[19], truth[39]), np.array([0.9, 0.0, 0.0]))
    bad = graph.joined(PoseGraph.of(graph.pose, [(19, 39)], [z], [np.diag([1e4, 1e4, 1e4])]))
    solved = solve_graph(bad)
    assert solve_graph(bad, PLAIN).nis[-1] < 16.27
    assert not solved.used[-1]
    assert solved.used[:-1].all()
    (told,) = solved.dropped
    assert ("most others" in told.reason) == (told.nis <= 16.27)
    fits = robust_graph._dropped(bad, 4, 16.0, 16.27, 0.25)
    assert (fits.edge, fits.first, fits.second, fits.nis) == (4, bad.first[4], bad.second[4], 16.0)
    assert fits.reason == "it lies 4.0 standard deviations from what the rest says, most others 0.50"


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 21])
def test_six_false_closures_on_ten_true_ones_leave_the_intel_graph_as_it_is(data, seed):
    graph = read_g2o(data / "g2o" / "intel.g2o.gz")
    rng, n = np.random.default_rng(seed), len(graph)
    first = rng.integers(0, n, 471)
    second = (first + rng.integers(2, n - 2, 471)) % n
    z = np.column_stack([rng.uniform(-5, 5, (471, 2)), rng.uniform(-3, 3, 471)])
    information = np.repeat(np.median(graph.information, axis=0)[None], 471, 0)
    solved = solve_graph(graph.joined(PoseGraph(graph.pose, first, second, z, information)))
    cost = squares(replace(graph, pose=solved.graph.pose)).sum()
    assert cost <= 1.1 * solve_graph(graph, PLAIN).chi2
    assert solved.used[: graph.edges].all()


def test_a_graph_without_contradictions_stays_whole():
    _, graph = laps(np.random.default_rng(5))
    solved = solve_graph(graph)
    assert solved.used.all()
    assert not solved.dropped
    assert solved.chi2 == pytest.approx(solve_graph(graph, PLAIN).chi2, rel=1e-6)


def test_what_hangs_on_false_closures_alone_becomes_a_part_of_its_own():
    truth, graph = laps(np.random.default_rng(6), n=30, closures=0)
    keep = graph.second != 15
    cut = PoseGraph(graph.pose, graph.first[keep], graph.second[keep], graph.measured[keep], graph.information[keep])
    assert connected(cut).max() == 1
    tie = [se2.between(truth[3], truth[20]), se2.compose(se2.between(truth[4], truth[22]), np.array([3.0, 0.0, 1.0]))]
    tie.append(se2.between(truth[5], truth[24]))
    tied = cut.joined(PoseGraph.of(graph.pose, [(3, 20), (4, 22), (5, 24)], tie, [np.diag(SD**-2.0)] * 3))
    solved = solve_graph(tied)
    assert not solved.used[-2]
    assert solved.component.max() == 0
    apart = solve_graph(cut)
    assert apart.fixed == (0, 15)
    assert np.array_equal(apart.component, np.arange(30) >= 15)
    assert apart.converged


def test_priors_hold_the_graph_where_they_say():
    truth, graph = laps(np.random.default_rng(7), n=20, closures=10)
    there = se2.compose(np.array([10.0, -3.0, 1.0]), truth)
    priors = [Prior(k, there[k], np.diag([1e6, 1e6, 1e6])) for k in (2, 12)]
    solved = solve_graph(graph, PLAIN, priors=priors)
    assert solved.fixed == ()
    assert np.abs(se2.between(solved.graph.pose, there)).max() < 0.2
    assert solved.prior_nis.shape == (2,)


def test_how_far_a_prior_lies_from_the_rest_is_what_solving_without_it_says():
    truth, graph = laps(np.random.default_rng(9), n=16, closures=8)
    rng = np.random.default_rng(10)
    B = rng.normal(size=(3, 3, 3))
    priors = [
        Prior(k, se2.compose(truth[k], rng.normal(0, 0.1, 3)), 100.0 * (b @ b.T + np.eye(3)))
        for k, b in zip((2, 7, 12), B, strict=True)
    ]
    told = solve_graph(graph, PLAIN, priors=priors)
    for pose, chi2 in ((graph.pose, told.chi2_before), (told.graph.pose, told.chi2)):
        off = se2.between(np.array([p.pose for p in priors]), pose[[2, 7, 12]])
        both = sum(r @ p.information @ r for r, p in zip(off, priors, strict=True))
        assert chi2 == pytest.approx(squares(replace(graph, pose=pose)).sum() + both)
    for k, prior in enumerate(priors):
        less = solve_graph(graph, PLAIN, priors=[p for p in priors if p is not prior])
        r = se2.between(prior.pose, less.graph.pose[prior.vertex])
        J = se2.turn(-float(prior.pose[2]))
        S = J @ less.covariances()[prior.vertex] @ J.T + np.linalg.inv(prior.information)
        assert told.prior_nis[k] == pytest.approx(r @ np.linalg.solve(S, r), rel=0.15, abs=0.05)
    assert told.prior_nis.max() > 1.0


def test_how_far_held_poses_lie_from_the_rest_is_told_with_the_first_of_each_part_alone_held():
    _, graph = laps(np.random.default_rng(6), n=30, closures=0)
    keep = graph.second != 15
    cut = PoseGraph(graph.pose, graph.first[keep], graph.second[keep], graph.measured[keep], graph.information[keep])
    moved = cut.pose.copy()
    held = (3, 9, 14, 20, 28)
    moved[[9, 14, 28]] += np.array([[0.1, -0.2, 0.05], [0.0, 0.3, 0.1], [-0.2, 0.1, -0.1]])
    told = solve_graph(replace(cut, pose=moved), PLAIN, fixed=held)
    free = solve_graph(replace(cut, pose=moved), PLAIN, fixed=(3, 20))
    P = free.covariances()
    for k, at in enumerate(held):
        off = moved[at] - free.graph.pose[at]
        off[2] = se2.wrap_angle(off[2])
        wanted = 0.0 if at in (3, 20) else off @ np.linalg.solve(P[at], off)
        assert told.fixed_nis[k] == pytest.approx(wanted, rel=1e-4, abs=1e-9)
        np.testing.assert_allclose(told.graph.pose[at], moved[at], atol=1e-14)
    assert told.fixed_nis[1] > 1.0
    assert not solve_graph(cut, PLAIN, fixed=(3, 20)).fixed_nis.any()


def test_graphs_nobody_can_solve_are_refused():
    _, graph = laps(np.random.default_rng(8), n=10, closures=2)
    information = graph.information.copy()
    information[3, 2, 2] = 0.0
    with pytest.raises(DataError, match="edge 3 is not positive definite"):
        solve_graph(replace(graph, information=information))
    with pytest.raises(DataError, match="not finite"):
        solve_graph(replace(graph, measured=graph.measured * np.nan))
    with pytest.raises(DataError, match="expected vertices 0 to 9, found 12"):
        solve_graph(graph, fixed=[12])
    with pytest.raises(DataError, match="found none"):
        solve_graph(PoseGraph.of(np.zeros((0, 3)), [], [], []))
    with pytest.raises(DataError, match="to itself"):
        solve_graph(graph.joined(PoseGraph.of(graph.pose, [(4, 4)], [np.zeros(3)], [np.eye(3)])))


@pytest.mark.data
@pytest.mark.parametrize("name", ["intel", "CSAIL", pytest.param("manhattan", marks=pytest.mark.slow)])
def test_public_graphs_have_the_optimum_that_gtsam_finds_with_the_same_residual(data, name):
    """GTSAM's own edges measure the residual by its logarithm; here they measure it as these do."""
    graph = read_g2o(data / "g2o" / f"{name}.g2o.gz")
    solved = solve_graph(graph, PLAIN)
    assert solved.converged
    theirs, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(solved.graph.pose.tolist()):
        values.insert(k, np.array(pose))
    for i, j, z, information in zip(
        graph.first.tolist(), graph.second.tolist(), graph.measured, graph.information, strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        theirs.add(gtsam.CustomFactor(noise, [i, j], _edge(z)))
    theirs.add(gtsam.PriorFactorVector(0, graph.pose[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    params.setAbsoluteErrorTol(1e-12)
    end = gtsam.LevenbergMarquardtOptimizer(theirs, values, params).optimize()
    assert 2 * theirs.error(values) == pytest.approx(solved.chi2, rel=1e-9)
    assert 2 * theirs.error(end) >= solved.chi2 * (1 - 1e-6)


def _edge(z):
    """The residual `z^-1 (a^-1 b)` and its derivatives, on plain vectors."""
    cz, sz = np.cos(z[2]), np.sin(z[2])
    Rz = np.array([[cz, sz], [-sz, cz]])

    def error(factor, values, H):
        a, b = map(values.atVector, factor.keys())
        c, s = np.cos(a[2]), np.sin(a[2])
        R = np.array([[c, s], [-s, c]])
        d = b[:2] - a[:2]
        local = R @ d
        if H is not None:
            A, B = np.zeros((3, 3)), np.zeros((3, 3))
            B[:2, :2], B[2, 2] = Rz @ R, 1.0
            A[:2, :2], A[2, 2] = -B[:2, :2], -1.0
            A[:2, 2] = Rz @ np.array([local[1], -local[0]])
            H[0], H[1] = np.asfortranarray(A), np.asfortranarray(B)
        e = Rz @ (local - z[:2])
        return np.array([e[0], e[1], np.arctan2(np.sin(b[2] - a[2] - z[2]), np.cos(b[2] - a[2] - z[2]))])

    return error


@pytest.mark.data
def test_real_graphs_survive_false_closures(data):
    graph = read_g2o(data / "g2o" / "CSAIL.g2o.gz")
    clean = solve_graph(graph, PLAIN)
    rng = np.random.default_rng(7)
    closures = int((np.abs(graph.second - graph.first) != 1).sum())
    for share in (0.1, 0.3, 0.6):
        count = round(share * closures)
        a = rng.integers(0, len(graph), count)
        b = (a + rng.integers(2, len(graph) - 2, count)) % len(graph)
        z = np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-3, 3, count)])
        pairs = list(zip(a.tolist(), b.tolist(), strict=True))
        false = PoseGraph.of(graph.pose, pairs, list(z), [np.median(graph.information, axis=0)] * count)
        solved = solve_graph(graph.joined(false))
        assert not solved.used[graph.edges :].any()
        assert squares(replace(graph, pose=solved.graph.pose)).sum() <= 1.05 * clean.chi2
