"""What scans say of a team, as factors: robots' own pose graphs, and keyframes of two robots that were matched."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.laser.robot_graph import RobotGraph
from mapweave.team.config import SmoothingConfig
from mapweave.team.factors import InterRobotEdge
from mapweave.team.problem import team_problem
from mapweave.team.smooth import dense_track

CFG = SmoothingConfig()
POINTS = np.array([[2.0, 1.0], [3.5, -1.0], [0.5, 2.5]])


def scanner(robot, n, rng):
    """The graph and track of a robot of `n` keyframes, one a second, and a log that has seen nothing."""
    t, pose = 1.0 + np.arange(n), np.column_stack([rng.uniform(-2, 2, (n, 2)), rng.uniform(-3, 3, n)])
    A = rng.normal(size=(n - 1, 3, 3))
    graph = RobotGraph(
        robot=robot,
        t=t,
        pose=pose,
        cov=np.zeros((n, 3, 3)),
        path=t,
        step=se2.between(pose[:-1], pose[1:]),
        step_information=A @ A.swapaxes(1, 2) + 50.0 * np.eye(3),
        closures=(),
        start=np.zeros(n + 1, dtype=int),
        points=np.zeros((0, 2)),
        normals=np.zeros((0, 2)),
        q=None,
        lined=np.zeros(0, dtype=bool),
        sensor=np.zeros((n, 2)),
    )
    return graph, Track(t, pose), LandmarkLog(robot, None, NOTHING_SEEN)


def camera(rng, of=(), at=None):
    """robot1, which stands at the origin and sees the landmarks, and the robots `of` where they stand."""
    t = np.arange(1.0, 6.0)
    places = np.concatenate([np.tile(POINTS, (5, 1)), *([] if at is None else [at])])
    seen = np.concatenate([np.repeat(t, 3), *([] if at is None else [t[: len(at)]])])
    what = np.concatenate([np.tile(np.arange(3), 5), np.full(len(places) - 15, 3)])
    order = np.argsort(seen, kind="stable")
    r, b = np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0])
    table = SightingTable(seen[order], what[order], r[order], b[order], ("a", "b", "c", *of))
    return LandmarkLog("robot1", None, table), Track(t, np.zeros((5, 3)))


def made(n, crossings=(), lasers=1, seen=False):
    rng = np.random.default_rng(n)
    scans = {f"robot{k + 2}": scanner(f"robot{k + 2}", n, rng) for k in range(lasers)}
    log, track = camera(rng, ("robot2",), scans["robot2"][1].pose[:, :2]) if seen else camera(rng)
    team = team_problem(
        [log, *(log for _, _, log in scans.values())],
        LandmarkMap(("a", "b", "c"), POINTS, 0.01 * np.eye(6)),
        {"robot1": track} | {robot: way for robot, (_, way, _) in scans.items()},
        {},
        {},
        CFG,
        scans={robot: graph for robot, (graph, _, _) in scans.items()},
        crossings=crossings,
    )
    return team, [graph for graph, _, _ in scans.values()]


def poses(team, k, x):
    part = team.parts[k]
    return x[part.start : part.start + 3 * len(part.instants.t)].reshape(-1, 3)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_a_robots_scans_hold_its_keyframes_as_its_graph_has_them_and_one_keyframe_holds_nothing(n):
    team, (graph,) = made(n)
    assert team.used.get("scan") == (n - 1 or None)
    for term in team.factors:
        assert len(term.columns), term.name
    x = team.problem.x0.copy()
    part = team.parts[1]
    assert not set(range(part.start, part.start + 3)) & set(team.problem.free.tolist())
    x[part.start + 3 : part.start + 3 * n] += 0.05
    solution = team.solve(x)
    np.testing.assert_allclose(poses(team, 1, solution.x), graph.pose, atol=1e-3)
    P = [solution.covariance(part.start + 3 * k + np.arange(3)) for k in range(n)]
    want = np.zeros((3, 3))
    for k in range(1, n):
        A, B = se2.between_jacobians(graph.pose[k - 1], graph.pose[k])
        C = np.linalg.inv(se2.turn(-graph.step[k - 1, 2]) @ B)  # what is known of a step is in the later one's frame
        J = -np.linalg.inv(B) @ A
        want = J @ want @ J.T + C @ np.linalg.inv(graph.step_information[k - 1]) @ C.T
        np.testing.assert_allclose(P[k], want, rtol=1e-3, atol=1e-6)


def test_a_robot_of_one_keyframe_lies_where_another_saw_it():
    team, _ = made(1, seen=True)
    assert "scan" not in team.used
    x = team.problem.x0.copy()
    at = team.parts[1].start + np.arange(2)
    x[at] += 0.3
    np.testing.assert_allclose(team.solve(x).x[at], team.problem.x0[at], atol=1e-3)


@pytest.mark.parametrize("n", [1, 4])
def test_between_keyframes_a_track_is_as_sure_as_both_share_it_and_of_one_keyframe_it_is_that(n):
    team, (graph,) = made(n)
    x = team.problem.x0.copy()
    part = team.parts[1]
    x[part.start : part.start + 3 * n] += np.tile([0.1, -0.2, 0.0], n)
    cov = np.eye(3) * np.arange(1.0, n + 1)[:, None, None]
    track = dense_track(part, x, cov)
    np.testing.assert_array_equal(track.t, graph.t)
    np.testing.assert_allclose(track.pose, graph.pose + np.array([0.1, -0.2, 0.0]), atol=1e-9)
    np.testing.assert_allclose(track.cov, cov)


def test_matched_keyframes_hold_two_robots_as_they_were_measured():
    z = np.array([0.4, -1.0, 2.0])
    crossings = [InterRobotEdge("robot2", "robot3", 2, 1, z, np.diag([400.0, 900.0, 1600.0]))]
    crossings.append(InterRobotEdge("robot2", "stranger", 0, 0, z, np.eye(3)))  # who is not of the team counts nothing
    team, (one, two) = made(3, crossings, lasers=2)
    assert team.used == {"landmark": 15, "scan": 2 + 2, "crossing": 1}
    solution = team.solve()
    x, n = solution.x, len(solution.x)
    np.testing.assert_allclose(se2.between(poses(team, 1, x)[2], poses(team, 2, x)[1]), z, atol=1e-3)
    np.testing.assert_allclose(
        se2.between(poses(team, 2, x)[0], poses(team, 2, x)[2]), se2.between(two.pose[0], two.pose[2]), atol=1e-3
    )
    np.testing.assert_allclose(poses(team, 1, x), one.pose, atol=1e-3)
    assert np.setdiff1d(np.arange(n), team.problem.free)[:6].tolist() == [0, 1, 2, *team.parts[1].start + np.arange(3)]
    (term,) = (term for term in team.factors if term.name == "crossing")
    for k, column in enumerate(term.columns[0]):
        d = 1e-6 * (np.arange(n) == column)
        change = (term.residual(x + d) - term.residual(x - d))[0] / 2e-6
        np.testing.assert_allclose(term.jacobian(x)[0, :, k], change, atol=1e-6)
    np.testing.assert_allclose(term.sqrt_info[0].T @ term.sqrt_info[0], crossings[0].information)
