"""Mixed teams in one problem: tied through each other, honest, whatever the order; what cannot be tied stays apart."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog
from mapweave.mapping.config import LaserConfig
from mapweave.solve import Factor
from mapweave.team import smooth as smoothing
from mapweave.team.config import PlacingConfig, SmoothingConfig
from mapweave.team.factors import InterRobotEdge
from mapweave.team.mixed import regained
from mapweave.team.problem import team_problem
from mapweave.team.relative_frame import Body, Layout, moved_track
from mapweave.team.walls import CommonWalls, Scanned, common_walls, in_line

from .mixed_teams import mixed

ONE_ROOM = {"lasers": 2, "cameras": 1, "bearing_cameras": 1, "bearings": 1, "minutes": 4.0}
TWO_ROOMS = {"lasers": 2, "cameras": 4, "bearings": 0, "rooms": 2, "landmarks": 24, "minutes": 5.0}


@pytest.fixture(scope="module")
def one_room():
    w = mixed(12, **ONE_ROOM)
    return w, w.map()


@pytest.fixture(scope="module")
def two_rooms():
    w = mixed(5, **TWO_ROOMS)
    return w, w.map()


def nees(w, made, robots):
    """Mean NEES per degree of freedom of the places of `robots`, under the score's alignment."""
    T, out = w.score(made).alignment, {}
    team = made.components[0].map
    for robot in robots:
        track, true = team.tracks[robot], w.truth.robots[robot].track
        e = (se2.compose(T, track.pose) - se2.interpolate(track.t, true.t, true.pose))[:, :2]
        R = se2.rotation(float(T[2]))
        P = R @ track.cov[:, :2, :2] @ R.T
        out[robot] = float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e).mean() / 2)
    return out


def test_everybody_is_in_one_frame_and_knows_how_well(one_room):
    w, made = one_room
    assert made.components[0].map.robots == tuple(log.robot for log in w.logs)
    score = w.score(made)
    assert all(score.robots[robot].ate < 0.15 for robot in ("robot1", "robot2", "robot3"))
    assert score.landmarks.rmse < 0.2
    assert set(made.components[0].used) == {"landmark", "robot", "scan"}
    found = nees(w, made, made.components[0].map.robots)
    assert all(n < 3.0 for n in found.values()), found


LASER = LaserConfig(method="graph", feature="none")


def test_lasers_that_saw_the_same_walls_lie_by_them_and_not_by_sightings_alone(one_room):
    w, loose = one_room
    made = w.map(laser=LASER)
    assert [merge.merged for merge in made.merges] == [True]
    assert made.paths == ()
    assert made.components[0].used["crossing"] >= 3
    apart, woven = ways_apart(w, loose), ways_apart(w, made)
    assert woven < 0.05 < apart
    assert woven < 0.5 * apart
    found = nees(w, made, ("robot1", "robot2"))
    assert all(n < 3.0 for n in found.values()), found


def ways_apart(w, made):
    """RMS error [m] of the ways of both lasers after one alignment of the two together."""
    tracks = [made.components[0].map.tracks[robot] for robot in ("robot1", "robot2")]
    true = [w.truth.robots[robot].track for robot in ("robot1", "robot2")]
    p = np.concatenate([track.pose[:, :2] for track in tracks])
    q = np.concatenate([se2.interpolate(a.t, b.t, b.pose)[:, :2] for a, b in zip(tracks, true, strict=True)])
    return float(np.sqrt(np.square(se2.act(se2.align(p, q), p) - q).sum(axis=1).mean()))


def test_lasers_that_nobody_saw_are_tied_by_the_walls_that_both_saw(one_room):
    w, _ = one_room
    own, right = w.scanned, true_relation(w)
    second = Scanned(own["robot2"].graph.moved(right), moved_track(own["robot2"].track, right))
    walls = CommonWalls({"robot1": own["robot1"], "robot2": second}, (("robot1", "robot2"),))
    bodies = (Body({"robot1": own["robot1"].track}, {}), Body({"robot2": own["robot2"].track}, {}))
    layout = in_line(Layout(bodies, (), ()), walls)
    assert [(tie.a, tie.b, tie.by) for tie in layout.ties] == [(("robot1",), ("robot2",), "walls")]
    (body,) = layout.bodies
    assert set(body.robots) == {"robot1", "robot2"}
    np.testing.assert_allclose(body.tracks["robot2"].pose[:, :2], second.track.pose[:, :2], atol=1e-9)


@pytest.mark.slow
def test_walls_that_fit_far_from_where_sightings_put_a_robot_are_not_believed(one_room):
    w, _ = one_room
    graphs = w.scanned
    moved = moved_track(graphs["robot2"].track, se2.compose(true_relation(w), np.array([0.5, 0.0, 0.0])))
    layout = Layout((Body({"robot1": graphs["robot1"].track, "robot2": moved}, {}),), (), ())
    for sure, merged in ((0.6, True), (0.1, False)):
        walls = common_walls(layout, graphs, LASER, PlacingConfig(sure_xy=sure))
        assert [m.merged for m in walls.merges] == [merged]
        assert walls.together("robot1", "robot2") == merged
        assert ("from where sightings of the team place them" in walls.merges[0].reason) != merged
        assert bool(walls.crossings) == merged


@pytest.mark.slow
def test_robots_with_lasers_and_cameras_are_tied_by_walls_too():
    w = mixed(31, lasers=2, cameras=0, bearings=0, minutes=2.0, everything=True)
    made = w.map(laser=LASER)
    assert made.components[0].map.robots == ("robot1", "robot2")
    assert [merge.merged for merge in made.merges] == [True]
    assert made.components[0].used["crossing"] >= 3
    assert ways_apart(w, made) < 0.06
    assert set(made.components[0].inflation.values()) == {1.0}  # that errors last stands in the noise already
    assert 0.25 < w.score(made).landmarks.nees_per_dof < 1.6


def test_ranges_are_believed_less_beside_lasers_and_nowhere_else(monkeypatch):
    w = mixed(31, lasers=2, cameras=0, bearings=0, minutes=2.0, everything=True)
    seen = [replace(log, odometry=None) for log in w.logs]

    def mapped(by, **given):
        monkeypatch.setattr(smoothing, "RANGE_BESIDE_LASER", by)
        return w.map(**given).components[0].map.landmarks

    as_usual, believed = mapped(2.0), mapped(1.0)
    assert np.trace(believed.cov) < 0.8 * np.trace(as_usual.cov)
    usual, same = (mapped(by, logs=seen, scanned={}) for by in (2.0, 1.0))
    assert np.array_equal(usual.mean, same.mean)


def true_relation(w):
    """Where the frame of robot 2's map lies in that of robot 1's, from the truth at their first stamps."""
    starts = []
    for robot in ("robot1", "robot2"):
        track, true = w.scanned[robot].track, w.truth.robots[robot].track
        here = se2.interpolate(track.t[:1], true.t, true.pose)[0]
        starts.append(se2.compose(here, se2.inverse(track.pose[0])))
    return se2.between(*starts)


def test_every_pose_has_a_covariance_that_can_be(one_room):
    _, made = one_room
    for track in made.components[0].map.tracks.values():
        assert np.isfinite(track.pose).all()
        assert np.linalg.eigvalsh(track.cov).min() > 0
        assert (np.diff(track.t) > 0).all()


@pytest.mark.slow
def test_lasers_that_see_no_common_wall_are_tied_through_those_who_see_both(two_rooms):
    w, made = two_rooms
    assert made.components[0].map.robots == tuple(log.robot for log in w.logs)
    (path,) = made.paths
    assert (path.robots[0], path.robots[-1]) == ("robot1", "robot2")
    assert path.robots[1:-1]
    assert path.sightings[0] >= 3
    assert path.sightings[-1] >= 3
    assert all(n >= 3 or m >= 3 for n, m in zip(path.sightings, path.landmarks, strict=True))
    tracks = made.components[0].map.tracks
    pair = []
    for robot in ("robot1", "robot2"):
        true = w.truth.robots[robot].track
        t = tracks[robot].t[len(tracks[robot].t) // 2]
        i = np.searchsorted(tracks[robot].t, t)
        pair.append((tracks[robot].pose[i], se2.interpolate(np.array([t]), true.t, true.pose)[0], tracks[robot].cov[i]))
    said, true = se2.between(pair[0][0], pair[1][0]), se2.between(pair[0][1], pair[1][1])
    assert np.hypot(*(said - true)[:2]) < 0.6
    assert abs(se2.wrap_angle((said - true)[2])) < 0.06


@pytest.mark.slow
def test_the_order_of_robots_does_not_matter(two_rooms):
    w, made = two_rooms
    back = w.map(w.logs[::-1], dict(reversed(w.scanned.items())), w.mapped[::-1])
    for robot, track in made.components[0].map.tracks.items():
        np.testing.assert_allclose(back.components[0].map.tracks[robot].pose, track.pose, atol=1e-9)
    np.testing.assert_allclose(back.components[0].map.landmarks.mean, made.components[0].map.landmarks.mean, atol=1e-9)
    assert back.paths == made.paths


@pytest.mark.slow
def test_those_whom_nothing_ties_stay_apart(two_rooms):
    w, _ = two_rooms
    deaf = [
        replace(
            log,
            sightings=log.sightings.select(
                np.array([not log.sightings.ids[k].startswith("robot") for k in log.sightings.what], bool)
            ),
        )
        for log in w.logs
    ]
    made = w.map(deaf)
    assert [s.map.robots for s in made.components][-2:] == [("robot1",), ("robot2",)]
    assert made.paths == ()
    alone = made.components[-1]
    assert alone.refused
    np.testing.assert_array_equal(alone.map.tracks["robot2"].pose, w.scanned["robot2"].track.pose)


def test_a_robot_that_sees_nothing_and_nobody_sees_is_named(one_room):
    w, made = one_room
    more = w.map([*w.logs, LandmarkLog("robot9", None, NOTHING_SEEN)])
    assert more.layout.lost == ("robot9",)
    np.testing.assert_allclose(more.components[0].map.landmarks.mean, made.components[0].map.landmarks.mean, atol=1e-9)


@pytest.mark.slow
def test_a_clock_that_is_ahead_is_found():
    w = mixed(6, lasers=2, cameras=4, bearings=0, minutes=5.0, noise=0.3, clock=1.5)
    assert max(abs(c) for c in w.clocks.values()) > 0.5
    made = w.map(own_clocks=list(w.scanned))
    for robot in w.scanned:
        assert made.clocks[robot].ahead == pytest.approx(w.clocks[robot], abs=0.15)
        assert abs(made.clocks[robot].ahead - w.clocks[robot]) < 3.5 * made.clocks[robot].sd
    score = w.score(made)
    assert all(score.robots[robot].ate < 0.2 for robot in w.scanned)
    assert made.components[0].map.robots == tuple(log.robot for log in w.logs)


def test_all_derivatives_are_those_of_differences(one_room):
    w, made = one_room
    team = made.components[0].map
    graphs = {robot: s.graph for robot, s in w.scanned.items()}
    rng = np.random.default_rng(0)
    crossings = [InterRobotEdge("robot1", "robot2", 3, 5, np.array([0.3, -0.2, 0.5]), np.diag([30.0, 20.0, 90.0]))]
    problem = team_problem(w.logs, team.landmarks, team.tracks, {}, {}, SmoothingConfig(), graphs, crossings)
    x = problem.problem.x0 + rng.normal(0, 0.02, len(problem.problem.x0))
    kinds = set()
    for term in problem.problem.terms:
        assert isinstance(term, Factor)
        kinds.add(term.name)
        if term.name == "odometry":
            continue  # checked where landmark logs are
        J = term.jacobian(x)
        for row in range(0, len(term.columns), max(1, len(term.columns) // 4)):
            for c, column in enumerate(term.columns[row]):
                d = np.zeros(len(x))
                d[column] = 1e-6
                change = term.residual(x + d)[row] - term.residual(x - d)[row]
                change = np.where(np.abs(change) > 1, se2.wrap_angle(change), change) / 2e-6
                np.testing.assert_allclose(J[row, :, c], change, atol=2e-4, rtol=1e-4, err_msg=term.name)
    assert {"scan", "crossing", "landmark", "robot", "wandering", "prior"} <= kinds


def test_a_sighting_without_a_range_says_nothing_of_distance(one_room):
    w, made = one_room
    team = made.components[0].map
    problem = team_problem(
        w.logs, team.landmarks, team.tracks, {}, {}, SmoothingConfig(), {r: s.graph for r, s in w.scanned.items()}
    )
    directed = [
        term
        for term, origin in zip(problem.factors, problem.origins, strict=True)
        if origin is not None and problem.parts[origin.robot].robot == "robot4" and term.name == "landmark"
    ]
    assert directed
    for term in directed:
        assert not term.whitened(problem.problem.x0)[:, 0].any()
        assert np.abs(term.whitened(problem.problem.x0)[:, 1]).max() > 0


@pytest.mark.slow
def test_a_robot_whose_filter_was_lost_comes_back_by_what_it_saw():
    w = mixed(1, lasers=0, cameras=3, bearings=0, minutes=4.0, outliers=0.3, calibration="random")
    maps, told = regained(w.mapped, w.logs, {}, SmoothingConfig(), PlacingConfig())
    assert {found.code for found in told} == {"placed-anew"}
    assert maps[0].robots == ("robot1", "robot2", "robot3")
    made = w.map(mapped=maps)
    assert all(r.ate < 0.2 for r in w.score(made).robots.values())


@pytest.mark.slow
def test_robots_whose_filters_did_well_are_left_alone(two_rooms):
    w, _ = two_rooms
    maps, told = regained(w.mapped, w.logs, {}, SmoothingConfig(), PlacingConfig())
    assert maps[0] is w.mapped[0]
    assert told == ()
