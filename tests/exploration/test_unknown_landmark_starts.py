"""Robots among landmarks that do not know where the others start: each for itself, until two maps are of one place."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.explore import explore
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.exploration.landmarks.belief import Explored
from mapweave.exploration.landmarks.config import ExploreConfig, find_scenario
from mapweave.exploration.landmarks.experiment import LandmarkMission, explore_once
from mapweave.fusion.handover import hand_over, join_maps
from mapweave.fusion.identities import match_names
from mapweave.landmarks.landmark_map import Submap, known_starts

FIELD = """
lower = [-30.0, -20.0]
upper = [30.0, 20.0]
landmarks = {landmarks}
starts = [[-12.0, -3.0, 0.4], [10.0, 6.0, -2.0]]
"""
LATTICE = [[x, y] for x in range(-24, 25, 12) for y in range(-12, 13, 12)]


def field(tmp_path, landmarks):
    path = tmp_path / "field.toml"
    path.write_text(FIELD.format(landmarks=landmarks))
    return path


def grown(rng, n):
    """A map of n landmarks around one robot, with a full covariance, and its submap's own truth."""
    points = rng.uniform(-20, 20, size=(n, 2))
    A = rng.normal(size=(3 + 2 * n, 3 + 2 * n))
    P = 1e-4 * (A @ A.T) + 1e-3 * np.eye(3 + 2 * n)
    return Submap("r", rng.normal(size=3), tuple(map(str, range(n))), points, P, "local")


@pytest.mark.parametrize("association", ["known", "jcbb"])
def test_robots_that_know_no_starts_find_each_other_and_make_one_true_map(association):
    cfg = ExploreConfig()
    cfg = replace(cfg, submap=replace(cfg.submap, association=association))
    runs = [
        explore_once(LandmarkMission(find_scenario("yuan"), 2, "paper", "landmarks", cfg=cfg, apart=True), seed)
        for seed in (500, 501, 502)
    ]
    for score, record in runs:
        assert score.finished
        assert (score.maps, score.wrong_meetings, score.missed) == (1, 0, 0)
        assert record.maps == (("robot1", "robot2"),)
        assert score.met == record.meetings[-1].step
        assert 0 < score.met < score.steps
        assert np.isnan(record.moments[score.met - 2].poses[1]).all()  # nobody knows yet where it is in the map
        last = record.moments[-1]
        assert np.hypot(*(last.poses[1] - last.true_poses[1])[:2]) < 3.0
    assert np.mean([score.map_error for score, _ in runs]) < 0.8
    assert np.mean([score.nees_per_dof for score, _ in runs]) < 1.5


def test_landmarks_on_a_lattice_join_nobody_and_that_is_told(tmp_path):
    """Where every part of the field looks like every other, maps fit in many ways."""
    out = tmp_path / "out"
    result = explore(field(tmp_path, LATTICE), out, unknown_starts=True, until=150)
    (told,) = result.runs
    assert (told.maps, told.met) == (2, None)
    assert "robot2: not found in the map of robot1, nor is what they mapped" in result.lines()
    assert "not found in the map of robot1" in (out / "report.html").read_text(encoding="utf-8")
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["unknown_starts"] is True
    assert metrics["maps"] == [["robot1"], ["robot2"]]
    (tried,) = metrics["meetings"]
    assert not tried["joined"]
    assert "another alignment" in tried["reason"]


def test_where_a_run_begins_does_not_tell_a_robot_where_the_others_are(tmp_path):
    """A robot that nobody has found drives the same however far from the others it began."""
    near, far = (
        FIELD.format(landmarks=LATTICE),
        FIELD.format(landmarks=LATTICE).replace("-12.0, -3.0, 0.4", "-24, -15, 2"),
    )
    poses = []
    for k, text in enumerate((near, far)):
        path = tmp_path / f"{k}.toml"
        path.write_text(text)
        mission = LandmarkMission(find_scenario(str(path)), 2, "paper", 1, apart=True)
        poses.append(explore_once(mission, 3)[1].moments[0].commands[1])
    np.testing.assert_array_equal(*poses)


def test_among_walls_robots_have_the_plan_and_unknown_starts_are_refused(tmp_path):
    path = field(tmp_path, 5)
    path.write_text(path.read_text() + "walls = [[0.0, 15.0, 0.0, 18.0]]\n")
    with pytest.raises(UsageError, match="--unknown-starts"):
        explore(path, unknown_starts=True, until=1)


def test_joined_maps_are_what_one_dense_update_makes_of_them():
    """Oracle: generalised least squares over both maps and the transform, by dense algebra about the answer."""
    rng = np.random.default_rng(5)
    first, second = grown(rng, 6), grown(rng, 5)
    start = known_starts(("a",), np.zeros((1, 3)))
    G = hand_over(start, replace(first, robot="a"), known=True).map
    T = np.array([7.0, -4.0, 1.1])
    links = np.array([[0, 1], [1, 3], [2, 4], [4, 0]])
    points = second.mean.copy()
    there = G.mean[links[:, 1]] + 0.02 * rng.normal(size=(4, 2))
    points[links[:, 0]] = se2.act(se2.inverse(T), there)
    second = replace(second, mean=points, robot="b", ids=tuple(f"n{k}" for k in range(5)))
    H = hand_over(known_starts(("b",), np.zeros((1, 3))), second, known=True).map
    done = join_maps(G, H, links, T)
    assert done.names == ("1", "3", "4", "n3", "0")
    assert done.map.ids == (*G.ids, "n3")
    assert done.map.robots == ("a", "b")

    def place(x):  # the linked landmarks of both maps in the first, from [G, T, H]
        g, t, h = x[: len(G.cov)], x[len(G.cov) : len(G.cov) + 3], x[len(G.cov) + 3 :]
        return g[3:].reshape(-1, 2)[links[:, 1]] - se2.act(t, h[3:].reshape(-1, 2)[links[:, 0]])

    x0 = np.concatenate([G.frames.ravel(), G.mean.ravel(), T, H.frames.ravel(), H.mean.ravel()])
    n = len(G.cov)
    W = np.zeros((len(x0), len(x0)))  # information of the prior: none of T
    W[:n, :n] = np.linalg.pinv(G.cov)
    W[n + 3 :, n + 3 :] = np.linalg.pinv(H.cov)
    x = x0.copy()
    for _ in range(20):  # constrained Gauss-Newton, by its KKT system
        J = np.stack([(place(x + e) - place(x - e)).ravel() / 2e-6 for e in 1e-6 * np.eye(len(x))], axis=1)
        K = np.block([[W, J.T], [J, np.zeros((8, 8))]])
        step = np.linalg.solve(K, np.concatenate([-W @ (x - x0), -place(x).ravel()]))
        x += step[: len(x)]
    cov = np.linalg.inv(K)[: len(x), : len(x)]
    np.testing.assert_allclose(done.T_map_other, x[n : n + 3], atol=2e-4)
    np.testing.assert_allclose(done.map.mean[:6], x[3:n].reshape(-1, 2), atol=2e-4)
    np.testing.assert_allclose(done.map.cov[6:18, 6:18], cov[3:n, 3:n], rtol=1e-3, atol=1e-6)
    new = se2.act(x[n : n + 3], x[n + 6 :].reshape(-1, 2)[3])
    np.testing.assert_allclose(done.map.mean[6], new, atol=2e-4)


def test_names_that_do_not_fit_together_join_nothing():
    rng = np.random.default_rng(2)
    a = grown(rng, 6).landmarks
    away = a.moved(np.array([3.0, 1.0, 2.0]), "other")
    match = match_names(away, a)
    assert match.accepted
    np.testing.assert_allclose(se2.compose(match.T_target_source, np.array([3.0, 1.0, 2.0])), 0.0, atol=1e-6)
    swapped = replace(away, ids=("1", "0", *away.ids[2:]))
    assert "do not fit" in match_names(swapped, a).reason
    few = away.select(("0", "3"))
    assert match_names(few, a).reason == "2 landmarks in common, 3 are needed"


def test_what_another_crew_saw_is_seen_where_it_lies():
    mine = Explored.over(np.array([-10.0, -10.0]), np.array([10.0, 10.0]), 1)
    its = Explored.over(np.array([-10.0, -10.0]), np.array([10.0, 10.0]), 2)
    its.fused[10:13, 10:16] = True  # x 0 to 6, y 0 to 3 of its own
    its.pending[1, 0, 0] = True
    both = mine.joined(its, np.array([4.0, 1.0, 0.5 * np.pi]))  # turned left about (4, 1)
    assert both.pending.shape == (3, 20, 20)
    rows, columns = np.nonzero(both.fused)
    assert (rows.min() - 10, rows.max() - 10, columns.min() - 10, columns.max() - 10) == (1, 6, 1, 3)
    assert both.fused.sum() == 18
    assert both.pending[2].sum() == 0  # it lies outside this field
