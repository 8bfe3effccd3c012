"""Closures of a keyframe graph: when a match is believed, in whose frame its covariance stands, where one looks."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.closures import (
    CLOSURE_BLUR,
    CLOSURE_FLOOR,
    CLOSURE_GATE,
    CLOSURE_TRUST,
    Matched,
    Place,
    PlaceMatcher,
)
from mapweave.laser.keyframes import Keyframe, believed, carried
from mapweave.laser.pose_graph import PoseGraph, Solved, problem
from mapweave.mapping.config import ALL_ROUND
from mapweave.mapping.keyframe_graph import KeyframeGraph, KeyframeGraphConfig
from mapweave.mapping.laser_team import LoopSearch

from ..differences import jacobian


def room_scan(pose, n=240):
    """What a scanner that sees all round has before it in a room of 8 x 5 m with a pillar."""
    angle = -np.pi + 2 * np.pi / n * np.arange(n)
    a = angle + pose[2] + 1e-9
    walls = [(np.sign(np.cos(a)) * 4.0 - pose[0]) / np.cos(a), (np.sign(np.sin(a)) * 2.5 - pose[1]) / np.sin(a)]
    r = np.min(np.where(np.array(walls) > 0, walls, np.inf), axis=0)
    d = np.array([2.0, 1.0]) - pose[:2]
    along = d[0] * np.cos(a) + d[1] * np.sin(a)
    inside = 0.4**2 - (d @ d - along**2)
    r = np.where((inside > 0) & (along > 0), np.minimum(r, along - np.sqrt(np.maximum(inside, 0))), r)
    return Scan(r, np.ones(n, bool), None, -np.pi, 2 * np.pi / n, 30.0)


def seen(pose):
    return beams(room_scan(np.asarray(pose, float)), "none", None, BeamConfig())


@pytest.fixture(scope="module")
def place():
    return Place([(seen([0.2 * k, 0.0, 0.0]), np.array([0.2 * k, 0.0, 0.0])) for k in range(-3, 4)])


def narrow(xy=0.02, turn=0.01):
    return np.diag([xy**2, xy**2, turn**2])


def test_a_match_where_the_estimate_allows_it_is_believed_with_its_own_information(place):
    true = np.array([0.3, 0.2, 0.1])
    match = PlaceMatcher(ALL_ROUND).match(place, seen(true), np.add(true, [0.02, -0.02, 0.005]), narrow(0.05, 0.02))
    assert match.accepted
    assert np.abs(se2.between(true, match.measured)).max() < 0.02
    matcher = PlaceMatcher(ALL_ROUND)
    matcher.front_end.hold(place.scans)
    lines = believed(matcher.front_end.information(seen(true), match.measured), CLOSURE_TRUST, CLOSURE_BLUR)
    floor = np.diag(CLOSURE_FLOOR**2)
    np.testing.assert_allclose(np.linalg.inv(match.information), np.linalg.inv(lines) + floor, rtol=1e-4, atol=1e-9)
    sd = np.sqrt(np.diag(np.linalg.inv(match.information)))
    assert (sd[:2] > CLOSURE_FLOOR[0]).all()
    assert (sd[:2] < 0.05).all()


def test_a_match_far_from_a_sure_estimate_is_refused(place):
    true = np.array([0.3, 0.2, 0.1])
    match = PlaceMatcher(ALL_ROUND).match(place, seen(true), np.add(true, [0.15, 0.15, 0.0]), narrow())
    assert np.abs(se2.between(true, match.measured)).max() < 0.03  # the match itself is right
    assert 3 * CLOSURE_GATE < match.nis < 50 * CLOSURE_GATE
    assert not match.accepted
    assert "standard deviations" in match.reason


def test_a_place_that_looks_alike_in_two_directions_is_refused(place, monkeypatch):
    matcher = PlaceMatcher(ALL_ROUND)
    true = np.array([0.3, 0.2, 0.1])
    for values, accepted in (([0.0, 0.5, 4e4], False), ([0.0, 2e4, 4e4], True)):
        monkeypatch.setattr(matcher.front_end, "information", lambda b, pose, v=values: np.diag(v))
        match = matcher.match(place, seen(true), true, narrow())
        assert match.accepted is accepted
        assert ("looks alike" in match.reason) is not accepted


def test_a_scan_without_returns_matches_nothing_and_is_refused_with_the_reason(place):
    b = seen([0.3, 0.2, 0.1])
    blind = b._replace(s=b.s[:0], normal=b.normal[:0], q=b.q[:0], support=b.support[:0])
    match = PlaceMatcher(ALL_ROUND).match(place, blind, np.array([0.3, 0.2, 0.1]), narrow())
    assert not match.accepted
    assert match.share == 0.0
    assert "too few returns match: 0 of 0" in match.reason


@pytest.mark.parametrize(("sd", "limits"), [(0.02, [0.3, 0.3, 0.1]), (0.2, [0.6, 0.6, 0.15])])
def test_a_match_may_leave_the_estimate_by_three_deviations_and_by_a_little_always(place, monkeypatch, sd, limits):
    matcher, asked = PlaceMatcher(ALL_ROUND), []
    match = matcher.front_end.match
    monkeypatch.setattr(matcher.front_end, "match", lambda b, start, most: asked.append(most) or match(b, start, most))
    matcher.match(place, seen([0.3, 0.2, 0.1]), np.array([0.3, 0.2, 0.1]), narrow(sd, 0.25 * sd))
    np.testing.assert_allclose(asked[0], limits)


def test_what_scattered_normals_tell_along_a_wall_counts_for_nothing():
    lines = np.diag([300.0, 5e4, 2e3])
    kept = believed(lines, 1.0, 0.02)
    assert kept[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert kept[1, 1] == pytest.approx(5e4 - 0.01 * (5e4 + 300.0))
    assert kept[2, 2] == 2e3
    assert np.allclose(believed(lines, 3.0, 0.0), 3.0 * lines)
    R = np.eye(3)
    R[:2, :2] = se2.rotation(0.7)
    assert np.allclose(believed(R @ lines @ R.T, 1.0, 0.02), R @ kept @ R.T)


def test_a_covariance_is_carried_over_a_step_as_small_errors_are():
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = np.array([*rng.normal(0, 2, 2), rng.uniform(-3, 3)])
        A = rng.normal(size=(3, 3))
        cov = A @ A.T
        h = 1e-6
        J = np.array([se2.between(step, se2.compose(h * e, step)) / h for e in np.eye(3)]).T
        assert np.allclose(carried(cov, step), J @ cov @ J.T, rtol=1e-4, atol=1e-4)


def driven(steps, cov, solve_after=None, spacing=1.0):
    """A graph of one robot's keyframes, each `step` from the last."""
    graph = KeyframeGraph(KeyframeGraphConfig(), np.zeros((1, 3)))
    none = seen([0.0, 0.0, 0.0])
    local = np.zeros(3)
    for k, step in enumerate(np.array([[0.0, 0.0, 0.0], *steps])):
        local = se2.compose(local, step)
        graph.add(Keyframe(0, k, float(k), local, np.asarray(step), cov if k else np.zeros((3, 3)), spacing * k, none))
        if k == solve_after:
            graph.solve()
    if solve_after is None:
        graph.solve()
    return graph


@pytest.mark.parametrize("solve_after", [None, 0])
def test_a_relative_covariance_stands_in_the_frame_of_the_later_keyframe(solve_after):
    cov = np.diag([0.04, 1e-4, 1e-6])
    graph = driven([[1.0, 0.5, 0.5 * np.pi]], cov, solve_after)
    assert np.allclose(graph.relative(0, 1), cov, rtol=1e-6, atol=1e-9)
    graph = driven([[1.0, 0.5, 0.5 * np.pi], [2.0, 0.0, -1.0]], cov, solve_after)
    assert np.allclose(graph.relative(0, 2), carried(cov, np.array([2.0, 0.0, -1.0])) + cov, rtol=1e-5, atol=1e-9)


def test_only_places_of_long_ago_are_searched_by_their_own_robot():
    cov = narrow()
    turn = 2 * np.pi / 12
    graph = driven([[1.0, 0.0, turn]] * 60, cov)  # round and round a circle of 2 m radius
    search = LoopSearch(PlaceMatcher(ALL_ROUND), 1)
    (found,) = search.candidates(graph, 60)
    assert graph.path[found] < graph.path[60] - 20.0
    assert search.candidates(graph, 19) == []


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_false_closures_are_found_out_however_many(share):
    """A way driven round three times; of all closures, `share` is false and agrees with nothing."""
    rng = np.random.default_rng(3)
    truth = [np.zeros(3)]
    for k in range(180):
        truth.append(se2.compose(truth[-1], np.array([0.5, 0.0, np.pi / 2 if k % 15 == 14 else 0.0])))
    truth = np.array(truth)
    true = se2.between(truth[:-1], truth[1:])
    sd = np.array([0.02, 0.02, 0.005])
    graph = driven(true + rng.normal(0.0, sd, true.shape), np.diag(sd**2), spacing=0.5)
    pairs = [(k, k + 60 * turn) for turn in (1, 2) for k in range(0, 181 - 60 * turn, 6)]
    false = int(share / (1.0 - share) * len(pairs))
    information = np.diag([2500.0, 2500.0, 40000.0])
    for i, k in pairs:
        z = se2.between(truth[i], truth[k]) + rng.normal(0.0, [0.02, 0.02, 0.005])
        graph.close(i, k, Matched(True, "", z, information, np.zeros(3), 1.0, 1.0))
    clean = graph.copy()
    clean.solve()
    for _ in range(false):
        i, k = sorted(rng.choice(181, 2, replace=False).tolist())
        z = np.array([*rng.uniform(-4, 4, 2), rng.uniform(-3, 3)])
        graph.close(i, k, Matched(True, "", z, information, np.zeros(3), 1.0, 1.0))
    graph.solve()
    kept = [c.accepted for c in graph.closures]
    assert all(kept[: len(pairs)])
    assert not any(kept[len(pairs) :])
    assert all("contradicts the other measurements" in c.reason for c in graph.closures[len(pairs) :])
    assert np.abs(graph.pose - clean.pose).max() < 1e-3


def test_covariances_of_a_solved_graph_are_those_of_the_dense_inverse():
    rng = np.random.default_rng(2)
    pose = np.column_stack([np.arange(5.0), rng.normal(0, 1, 5), rng.uniform(-2, 2, 5)])
    pairs = [(k, k + 1) for k in range(4)]
    z = [se2.between(pose[i], pose[j]) for i, j in pairs]
    roots = rng.normal(size=(6, 3, 3))
    information = [1e3 * (r @ r.T + np.eye(3)) for r in roots]
    steps = PoseGraph.of(pose, pairs, z, information[:4])
    loops = [(0, 3), (1, 4)]
    closed = PoseGraph.of(pose, loops, [se2.between(pose[i], pose[j]) for i, j in loops], information[4:])
    sd = np.array([[0.1, 0.2, 0.05]])
    solved = Solved.of(problem(steps, closed, (np.array([0]), pose[:1], sd), 3.0))
    np.testing.assert_allclose(solved.pose, pose, atol=1e-6)
    x = pose.ravel()

    def residual(v):
        X = v.reshape(-1, 3)
        first = (X[0] - pose[0]) / sd[0]
        rest = [
            np.linalg.cholesky(W).T @ se2.between(m, se2.between(X[i], X[j]))
            for (i, j), m, W in zip([*pairs, *loops], [*z, *closed.measured], information, strict=True)
        ]
        return np.concatenate([first, *rest])

    J = jacobian(residual, x)
    P = np.linalg.inv(J.T @ J)
    for k, block in enumerate(solved.covariances()):
        at = 3 * k + np.arange(3)
        np.testing.assert_allclose(block, P[np.ix_(at, at)], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(solved.marginal(k), block, rtol=1e-6, atol=1e-12)
    at = np.concatenate([3 + np.arange(3), 12 + np.arange(3)])

    def between(v):
        return se2.between(v[:3], v[3:])

    D = jacobian(between, x[at])
    np.testing.assert_allclose(solved.relative(1, 4), D @ P[np.ix_(at, at)] @ D.T, rtol=1e-4, atol=1e-9)
