"""The team's problem in small: its parts against dense algebra and against what its words say."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry, Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.solve import SolveStatus
from mapweave.team import robot_part
from mapweave.team.config import (
    CLUSTER,
    FEW_RAISED,
    HEADING_FLOOR,
    MOST_CORRECTED,
    POSITION_FLOOR,
    SMOOTHING_MEMORY,
    UNKNOWN_SLIP,
    UNKNOWN_SPEED,
    UNKNOWN_SPIN,
    CalibrationPrior,
    MotionNoise,
    SmoothingConfig,
)
from mapweave.team.covariance import (
    MOST_TAKEN,
    Groups,
    _correlation,
    _Known,
    _motions,
    _priors,
    scatter,
    scores,
    taken_out,
    team_covariance,
)
from mapweave.team.problem import HELD_TOGETHER, TeamProblem, _nodes, team_problem
from mapweave.team.robot_part import (
    MOTION_REST_THETA,
    MOTION_REST_XY,
    PARAMETERS,
    CommandedMotion,
    Instants,
    instants_of,
    random_walk,
)
from mapweave.team.smooth import dense_track, is_observed, smooth
from mapweave.team.team_map import TeamMap

CFG = SmoothingConfig()
POINTS = np.array([[2.0, 1.0], [3.5, -1.0], [0.5, 2.5], [4.0, 2.0], [1.0, -2.0]])
NAMES = tuple("abcde")
SOLVE = TeamProblem.solve
FIELDS = ("t", "what", "range", "bearing")


def driven(robot, start, rng, seconds=18.0, noise=1.0, odometry=True):
    """A robot that drives as commanded and sees every point each 1.5 s, and robot1 sees robot2."""
    t = np.arange(0.0, seconds, 0.3)
    commands = Odometry(t, rng.uniform(0.1, 0.3, len(t)), rng.uniform(-0.4, 0.5, len(t)))
    seen = np.repeat(np.arange(0.7, seconds, 1.5), len(POINTS))
    motion = CommandedMotion.of(commands, 2.0)
    at = np.unique(np.concatenate([t, seen]))
    pose = se2.compose(start, motion.at(at, 1.0, 0.95, 0.15)[0])
    track = Track(at, pose)
    eye = pose[np.searchsorted(at, seen)]
    d = np.tile(POINTS, (len(seen) // len(POINTS), 1)) - eye[:, :2]
    r = np.hypot(*d.T) + noise * 0.05 * rng.normal(size=len(seen))
    b = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - eye[:, 2] + noise * 0.02 * rng.normal(size=len(seen)))
    table = SightingTable(seen, np.tile(np.arange(len(POINTS)), len(seen) // len(POINTS)), r, b, NAMES)
    return LandmarkLog(robot, commands if odometry else None, table), track


def logs_and_map(noise=1.0, odometry=True):
    rng = np.random.default_rng(3)
    made = [
        driven("robot1", np.zeros(3), rng, noise=noise),
        driven("robot2", np.array([1.0, 2.0, -1.0]), rng, noise=noise, odometry=odometry),
    ]
    landmarks = LandmarkMap(NAMES, POINTS + 0.02 * noise * rng.normal(size=POINTS.shape), 0.01 * np.eye(10))
    return [log for log, _ in made], landmarks, {log.robot: track for log, track in made}


@pytest.fixture(scope="module")
def solved():
    logs, landmarks, tracks = logs_and_map()
    team = team_problem(logs, landmarks, tracks, {}, {}, CFG)
    return team, team.solve()


def dense_information(team, x, free, length=None):
    """As the costs are curved; with `length`, of every group of one robot's factors so many seconds long: a list."""
    begin = min(part.instants.t[0] for part in team.parts)
    of = {}
    for term, origin in zip(team.problem.terms, team.origins, strict=True):
        if origin is None and length is not None:
            continue
        for i, (columns, block) in enumerate(zip(term.columns, term.normal(x)[0], strict=True)):
            group = 0 if length is None else (origin.robot, int((origin.t[i] - begin) // length))
            H = of.setdefault(group, np.zeros((len(x), len(x))))
            H[np.ix_(columns, columns)] += term.curvature(x) * block
    found = [H[np.ix_(free, free)] for H in of.values()]
    return found[0] if length is None else found


def frame_of_the_body(team, x):
    """What takes the motion of the landmarks as a whole off every error: (n, n)."""
    M, n = _motions(team, x), len(x)
    taken = np.zeros((3, n))
    body = M[team.landmark_columns]
    taken[:, team.landmark_columns] = np.linalg.inv(body.T @ body) @ body.T
    return np.eye(n) - M @ taken


def test_what_shifts_and_turns_the_whole_changes_no_sighting_and_no_step(solved):
    team, solution = solved
    x, h = solution.x, 1e-5
    for motion in _motions(team, x).T:
        assert np.abs(motion).max() >= 1.0
        for term, origin in zip(team.problem.terms, team.origins, strict=True):
            if origin is not None:
                change = (term.residual(x + h * motion) - term.residual(x - h * motion)) / (2 * h)
                assert np.abs(change).max() < 1e-5, term.name


def test_model_covariances_of_poses_are_those_of_the_dense_inverse_in_the_frame_of_the_landmarks(solved):
    team, solution = solved
    n, free = len(solution.x), solution.free
    P = np.zeros((n, n))
    P[np.ix_(free, free)] = np.linalg.inv(dense_information(team, solution.x, free))
    T = frame_of_the_body(team, solution.x)
    P = T @ P @ T.T
    got = np.concatenate(_Known.of(team, solution, Groups.of(team, CLUSTER)).pose_blocks())
    for k in range(len(got)):
        at = 3 * k + np.arange(3)
        np.testing.assert_allclose(got[k], P[np.ix_(at, at)], rtol=1e-4, atol=1e-9)


def pulls(team, x, length):
    """Every group's pull on every variable, by adding one factor after the other."""
    begin = min(part.instants.t[0] for part in team.parts)
    out = {}
    for term, origin in zip(team.problem.terms, team.origins, strict=True):
        if origin is None:
            continue
        for t, columns, g in zip(origin.t, term.columns, term.normal(x)[1], strict=True):
            row = out.setdefault((origin.robot, int((t - begin) // length)), np.zeros(len(x)))
            np.add.at(row, columns, g)
    return np.array(list(out.values()))


def test_groups_of_factors_pull_as_their_sum_does(solved):
    team, solution = solved
    want = pulls(team, solution.x, 5.0)
    got = scores(team, solution.x, Groups.of(team, 5.0)).toarray()
    assert got.shape == want.shape == (8, len(solution.x))
    np.testing.assert_allclose(got.T @ got, want.T @ want, rtol=1e-6, atol=1e-6 * np.abs(want).max() ** 2)


def test_priors_pull_with_their_information(solved):
    team, solution = solved
    rows = _priors(team, solution.x).toarray()
    known = np.zeros(len(solution.x))
    for part in team.parts:
        for k, name in enumerate(PARAMETERS):
            known[part.parameters + k] = getattr(CFG.calibration, f"{name}_sd") ** -2.0
    np.testing.assert_allclose(rows.T @ rows, np.diag(known), rtol=1e-6)


def test_landmarks_have_the_sandwich_of_the_dense_inverse(solved):
    team, solution = solved
    x, free = solution.x, solution.free
    inverse = np.zeros((len(x), len(x)))
    inverse[np.ix_(free, free)] = np.linalg.inv(dense_information(team, x, free))
    scores, known = pulls(team, x, 0.8), _priors(team, x).toarray()
    shared = (free >= team.landmark_start).sum()
    taken_out = len(scores) / max(len(scores) - shared, len(scores) / MOST_CORRECTED)
    middle = taken_out * scores.T @ scores + known.T @ known
    T = frame_of_the_body(team, x)
    wanted = T @ inverse @ middle @ inverse @ T.T
    known = _Known.of(team, solution, Groups.of(team, 0.8))
    hubs = np.arange(team.landmark_start, len(x))
    moved = known.influence(hubs, MOST_CORRECTED)
    np.testing.assert_allclose(moved.T @ moved, wanted[np.ix_(hubs, hubs)], rtol=1e-3, atol=1e-9)


def scattered_by(team, x, free):
    """The number on the model's covariance where groups are few, and the dense covariance of the landmarks."""
    H = dense_information(team, x, free)
    P = np.zeros((len(x), len(x)))
    P[np.ix_(free, free)] = np.linalg.inv(H)
    T, at = frame_of_the_body(team, x), team.landmark_columns
    model = (T @ P @ T.T)[np.ix_(at, at)]
    value, vector = np.linalg.eigh(model)
    white = vector[:, 3:] / np.sqrt(value[3:])
    looked = (T[at].T @ white)[free]
    found = pulls(team, x, CLUSTER)[:, free] @ np.linalg.inv(H) @ looked
    known = _priors(team, x).toarray()[:, free] @ np.linalg.inv(H) @ looked
    shown = np.square(found).sum() / (white.shape[1] - np.square(known).sum())
    C = np.linalg.inv(H) @ looked
    each = dense_information(team, x, free, CLUSTER)
    taken = sum(np.trace(C.T @ G @ np.linalg.inv(H) @ G @ C) for G in each) / sum(np.trace(C.T @ G @ C) for G in each)
    return shown, taken, model, known @ np.linalg.pinv(white)


def test_how_groups_scatter_and_what_residuals_lack_are_those_of_the_dense_inverse(solved):
    team, solution = solved
    x, free = solution.x, solution.free
    shown, taken, model, _ = scattered_by(team, x, free)
    groups = Groups.of(team, CLUSTER)
    known = _Known.of(team, solution, groups)
    white, looked = known.whitened(known.model())
    assert white.shape == (len(model), len(model) - 3)
    moved = known.influence(team.landmark_columns, 1.0) @ white
    assert scatter(moved, known.groups) == pytest.approx(shown, rel=1e-4)
    assert 0.1 < taken < MOST_TAKEN
    assert taken_out(team, x, groups, known.information, free, looked) == pytest.approx(taken, rel=1e-4)


@pytest.mark.parametrize("noise", [0.2, 1.0, 3.0])
def test_with_few_groups_landmarks_have_the_models_covariance_times_how_much_the_groups_scatter(noise):
    logs, landmarks, tracks = logs_and_map(noise)
    team = team_problem(logs, landmarks, tracks, {}, {}, CFG)
    solution = team.solve()
    shown, taken, model, known = scattered_by(team, solution.x, solution.free)
    by = (1.0 + FEW_RAISED) * (shown + taken * max(1.0, shown / (1.0 - taken)))
    priors = known.T @ known
    few = team_covariance(team, solution, np.eye(10)).landmarks - POSITION_FLOOR**2 * np.eye(10)
    np.testing.assert_allclose(few, by * (model - priors) + priors, rtol=2e-3, atol=1e-8)
    assert noise > 1.0 or 0.0 < shown < 1.0  # the noise that is assumed is twice the usual scatter


def test_a_robots_covariances_have_their_floor_and_the_larger_of_both_factors(solved):
    team, solution = solved
    cov = team_covariance(team, solution, 0.01 * np.eye(10))
    blocks = _Known.of(team, solution, Groups.of(team, CLUSTER)).pose_blocks()
    floor = np.diag([POSITION_FLOOR**2, POSITION_FLOOR**2, HEADING_FLOOR**2])
    shown, taken, *_ = scattered_by(team, solution.x, solution.free)
    by = (1.0 + FEW_RAISED) * (shown + taken * max(1.0, shown / (1.0 - taken)))
    for k, (P, model) in enumerate(zip(cov.poses, blocks, strict=True)):
        assert cov.inflation[k] == pytest.approx(max(by, _correlation(team, k, solution.x, SMOOTHING_MEMORY)), rel=1e-4)
        np.testing.assert_allclose(P, cov.inflation[k] * model + floor, atol=1e-12)
    assert all((sd > 0).all() for sd in cov.calibration)


def test_pulls_that_show_nothing_leave_the_model_as_it_is():
    assert scatter(np.zeros((3, 0)), 2) == 1.0
    assert scatter(np.ones((1, 4)), 0) == 1.0
    assert scatter(np.array([[3.0, 0.0], [0.0, 1.0], [0.0, 0.5]]), 2) == pytest.approx(10.0 / 1.75)


def test_sightings_that_err_together_are_told_from_those_that_do_not():
    logs, landmarks, tracks = logs_and_map()
    table = logs[0].sightings
    slow = table.range + 0.3 * np.sin(0.2 * table.t + table.what)
    team = team_problem(
        [replace(logs[0], sightings=replace(table, range=slow)), logs[1]], landmarks, tracks, {}, {}, CFG
    )
    x = team.problem.x0
    factors = [_correlation(team, k, x, SMOOTHING_MEMORY) for k in (0, 1)]
    for robot, factor in enumerate(factors):
        part, together, alone = team.parts[robot], 0.0, 0.0
        (term,) = (
            term
            for term, origin in zip(team.problem.terms, team.origins, strict=True)
            if term.name == "landmark" and origin.robot == robot
        )
        g = term.normal(x)[1][:, 3:5]
        t, what = part.log.sightings.t, part.log.sightings.what
        for landmark in range(5):
            for slot in range(5):
                rows = (what == landmark) & (t // SMOOTHING_MEMORY == slot)
                together += np.square(g[rows].sum(axis=0)).sum()
                alone += np.square(g[rows]).sum()
        assert factor == pytest.approx(max(1.0, together / alone))
    assert factors[0] > 1.5
    assert _correlation(team, 0, x, 1e-3) == 1.0


def test_of_a_robot_that_saw_no_landmark_the_others_sightings_of_it_are_asked():
    rng = np.random.default_rng(8)
    (one, two), landmarks, tracks = logs_and_map()
    stamps = np.arange(1.0, 17.0, 0.4)
    eye, there = (se2.interpolate(stamps, tracks[r].t, tracks[r].pose) for r in ("robot1", "robot2"))
    d = se2.between(eye, there)
    r = np.hypot(d[:, 0], d[:, 1]) + 0.3 * np.sin(0.3 * stamps) + 0.02 * rng.normal(size=len(stamps))
    own = one.sightings
    seen, order = np.concatenate([own.t, stamps]), np.argsort(np.concatenate([own.t, stamps]), kind="stable")
    table = SightingTable(
        seen[order],
        np.concatenate([own.what, np.full(len(stamps), 5)])[order],
        np.concatenate([own.range, r])[order],
        np.concatenate([own.bearing, np.arctan2(d[:, 1], d[:, 0])])[order],
        (*own.ids, "robot2"),
    )
    blind = replace(two, sightings=replace(two.sightings, **{f: getattr(two.sightings, f)[:0] for f in FIELDS}))
    team = team_problem([replace(one, sightings=table), blind], landmarks, tracks, {}, {}, CFG)
    x = team.problem.x0
    ((term, origin),) = ((t, o) for t, o in zip(team.problem.terms, team.origins, strict=True) if t.name == "robot")
    assert origin.robot == 0
    np.testing.assert_array_equal(origin.t, stamps)
    g = term.normal(x)[1][:, 3:5]
    slots = [stamps // SMOOTHING_MEMORY == slot for slot in range(5)]
    together = sum(np.square(g[rows].sum(axis=0)).sum() for rows in slots)
    factor = _correlation(team, 1, x, SMOOTHING_MEMORY)
    assert factor == pytest.approx(together / np.square(g).sum())
    assert factor > 1.5
    alone = team_problem([one, blind], landmarks, tracks, {}, {}, CFG)
    assert _correlation(alone, 1, alone.problem.x0, SMOOTHING_MEMORY) == 1.0


def at_rest(monkeypatch, **kind):
    """Robots wander by nothing but what is given, at rest or without commands."""
    for name in ("REST_XY", "REST_THETA", "LOST_XY", "LOST_THETA"):
        monkeypatch.setattr(robot_part, f"MOTION_{name}", kind.get(name.lower(), 0.0))


def test_heading_that_wanders_moves_a_robot_aside_as_its_integral_does(monkeypatch):
    """Brownian heading over the way: aside L^3 / 3, with the heading L^2 / 2, each times the rate's square."""
    at_rest(monkeypatch)
    quiet = MotionNoise(along=0, across=0, drift=0.2, turn=0)
    motion = CommandedMotion.of(Odometry(np.arange(0.0, 4.0, 0.1), np.full(40, 0.5), np.zeros(40)), 2.0)
    (Q,) = motion.noise(np.array([0.5, 3.5]), 0.0, quiet)
    way = 1.5
    wanted = 0.04 * np.array([[0, 0, 0], [0, way**3 / 3, way**2 / 2], [0, way**2 / 2, way]])
    np.testing.assert_allclose(Q, wanted, atol=1e-12)


def test_each_kind_of_noise_grows_with_what_it_is_of(monkeypatch):
    t, n = np.arange(0.0, 4.0, 0.1), 40
    motion = CommandedMotion.of(Odometry(t, np.full(n, -0.5), np.full(n, 0.4)), 2.0)
    zero = dict.fromkeys(("along", "across", "drift", "turn"), 0.0)
    at_rest(monkeypatch)
    stamps = np.array([0.6, 3.1])
    way, angle, dt = 1.25, 1.0, 2.5

    def diagonal(**kind):
        return np.diag(motion.noise(stamps, 0.1, MotionNoise(**(zero | kind)))[0])

    np.testing.assert_allclose(diagonal(along=0.3), [0.09 * way, 0, 0])
    np.testing.assert_allclose(diagonal(across=0.3), [0, 0.09 * way, 0])
    np.testing.assert_allclose(diagonal(turn=0.3)[2], 0.09 * angle)
    at_rest(monkeypatch, rest_xy=0.3)
    np.testing.assert_allclose(diagonal(), [0.09 * dt, 0.09 * dt, 0])
    at_rest(monkeypatch, rest_theta=0.3)
    np.testing.assert_allclose(diagonal()[2], 0.09 * dt)
    at_rest(monkeypatch, lost_xy=0.3, lost_theta=0.3)
    assert not diagonal().any()
    at_rest(monkeypatch, lost_xy=0.3, lost_theta=0.2)
    late = motion.noise(np.array([3.0, 8.0]), 0.0, MotionNoise(**zero))[0]
    lost = 5.0 - (3.9 + 2.0 - 3.0)  # the last command holds for 2 s
    np.testing.assert_allclose(
        np.diag(late), [0.09 * lost, 0.09 * lost + 0.04 * lost * (0.5 * 2.9) ** 2 / 3, 0.04 * lost]
    )


def test_a_robot_whose_commands_nobody_knows_wanders_with_the_time():
    Q = random_walk(np.array([0.0, 1.0, 4.0]))
    for k, dt in enumerate((1.0, 3.0)):
        speeds = np.array([UNKNOWN_SPEED, UNKNOWN_SLIP, UNKNOWN_SPIN])
        rest = np.array([MOTION_REST_XY, MOTION_REST_XY, MOTION_REST_THETA])
        np.testing.assert_allclose(Q[k], np.diag((speeds * dt) ** 2 + rest**2 * dt))


def test_the_nearest_instant_is_the_nearest():
    rng = np.random.default_rng(5)
    t = np.sort(rng.uniform(0, 10, 12))
    poses = np.column_stack([t, 2 * t, 0.1 * t])
    instants = Instants(t, poses, Track(t, poses), np.diff(t))
    asked = np.concatenate([rng.uniform(-1, 11, 60), t])
    np.testing.assert_array_equal(instants.nearest(asked), np.abs(asked[:, None] - t).argmin(axis=1))
    k, step = instants.from_nearest(asked[:60].clip(t[0], t[-1]))
    there = se2.compose(poses[k], step)
    np.testing.assert_allclose(there[:, 1], 2 * there[:, 0], atol=1e-9)
    np.testing.assert_allclose(there[:, 0], asked[:60].clip(t[0], t[-1]), atol=1e-9)
    one = Instants(t[:1], poses[:1], Track(t[:1], poses[:1]), np.zeros(0))
    assert one.nearest(np.array([-3.0, 4.0])).tolist() == [0, 0]


def test_instants_are_where_something_is_seen_neither_too_dense_nor_too_far_apart():
    (log, _), _, tracks = logs_and_map()
    cfg = replace(CFG, longest_step=1.0, shortest_step=0.6)
    seen_at = np.array([-5.0, 3.13, 3.2, 99.0])
    at = instants_of(log, seen_at, tracks["robot1"], cfg)
    first, last = log.span
    assert at.t[0] == first
    assert at.gap.shape == (len(at.t) - 1,)
    assert (at.gap >= np.diff(at.t) - 1e-9).all()
    assert np.diff(at.t).max() <= 1.0 + 1e-9
    kept = at.t[np.isin(at.t, np.concatenate([[first, last], log.sightings.t, seen_at]))]
    assert np.diff(kept).min() >= 0.6 - 1e-9
    assert at.t.min() >= first
    assert at.t.max() <= last
    assert 3.13 in at.t or np.abs(kept - 3.13).min() < 0.6
    sparse = instants_of(log, seen_at, tracks["robot1"], replace(CFG, longest_step=50.0))
    assert np.isin(sparse.t, np.concatenate([[first, last], log.sightings.t, seen_at])).all()
    np.testing.assert_allclose(at.start, se2.interpolate(at.t, tracks["robot1"].t, tracks["robot1"].pose))


def test_the_calibration_is_pulled_to_what_was_known_by_its_deviations():
    logs, landmarks, tracks = logs_and_map()
    known = {"robot2": {"lag": (0.3, 0.05), "range_scale": (1.1, 0.0)}}
    team = team_problem(logs, landmarks, tracks, {}, known, CFG)
    (prior,) = (term for term in team.problem.terms if term.name == "prior")
    x = team.problem.x0.copy()
    assert prior.squares(x).sum() == pytest.approx(0.0)
    one, two = team.parts
    assert x[two.parameters + 2] == 0.3
    assert x[two.parameters + 4] == 1.1
    assert two.parameters + 4 not in team.problem.free
    assert one.parameters + 4 in team.problem.free
    x[two.parameters + 2] += 0.1
    x[one.parameters] += 3 * CFG.calibration.speed_scale_sd
    assert prior.squares(x).sum() == pytest.approx(2.0**2 + 3.0**2)


def test_a_team_without_any_odometry_keeps_the_size_of_the_map_it_begins_with():
    logs, landmarks, tracks = logs_and_map()
    blind = [replace(log, odometry=None) for log in logs]
    team = team_problem(blind, landmarks, tracks, {}, {}, CFG)
    (size,) = (term for term in team.problem.terms if term.name == "size")
    x, at, h = team.problem.x0.copy(), team.landmark_columns, 1e-6
    assert size.squares(x)[0] == pytest.approx(0.0, abs=1e-9)
    middle = np.tile(x[at].reshape(-1, 2).mean(axis=0), len(at) // 2)
    larger = x.copy()
    larger[at] = middle + np.exp(2 * HELD_TOGETHER) * (x[at] - middle) + 3.0
    assert size.squares(larger)[0] == pytest.approx(2.0**2)
    for k, column in enumerate(size.columns[0]):
        d = np.zeros(len(x))
        d[column] = h
        change = (size.residual(larger + d) - size.residual(larger - d))[0, 0] / (2 * h)
        assert size.jacobian(larger)[0, 0, k] == pytest.approx(change, abs=1e-6)
    assert not {part.parameters + k for part in team.parts for k in (0, 1, 2)} & set(team.problem.free.tolist())
    one = team_problem([logs[0], blind[1]], landmarks, tracks, {}, {}, CFG)
    assert "size" not in {term.name for term in one.problem.terms}


def test_a_team_without_odometry_and_with_one_landmark_keeps_the_mean_of_its_range_scales():
    logs, landmarks, tracks = logs_and_map()
    one = LandmarkMap(NAMES[:1], landmarks.mean[:1], landmarks.cov[:2, :2])
    team = team_problem([replace(log, odometry=None) for log in logs], one, tracks, {}, {}, CFG)
    (scale,) = (term for term in team.problem.terms if term.name == "scale")
    x = team.problem.x0.copy()
    for part, off in zip(team.parts, (0.05, -0.05), strict=True):
        x[part.parameters + 4] += off
    assert scale.squares(x)[0] == pytest.approx(0.0, abs=1e-9)
    x[team.parts[0].parameters + 4] += 2 * HELD_TOGETHER
    assert scale.squares(x)[0] == pytest.approx(1.0)


def test_the_first_pose_is_the_frame_and_so_is_that_of_who_saw_nothing_in_common():
    logs, landmarks, tracks = logs_and_map()
    team = team_problem(logs, landmarks, tracks, {}, {}, CFG)
    held = np.setdiff1d(np.arange(len(team.problem.x0)), team.problem.free)
    assert held.tolist() == [0, 1, 2]
    stranger = replace(logs[1].sightings, ids=tuple("vwxyz"))
    apart = team_problem([logs[0], replace(logs[1], sightings=stranger)], landmarks, tracks, {}, {}, CFG)
    start = apart.parts[1].start
    held = np.setdiff1d(np.arange(len(apart.problem.x0)), apart.problem.free)
    assert held.tolist() == [0, 1, 2, start, start + 1, start + 2]
    named = {"robot2": dict(zip("vwxyz", NAMES, strict=True))}
    tied = team_problem([logs[0], replace(logs[1], sightings=stranger)], landmarks, tracks, named, {}, CFG)
    assert tied.used == team.used


def test_a_track_goes_through_every_estimated_pose_and_bends_evenly_between(solved):
    team, solution = solved
    part = team.parts[1]
    n = len(part.instants.t)
    poses = solution.x[part.start : part.start + 3 * n].reshape(-1, 3)
    cov = np.eye(3) * np.arange(1.0, n + 1)[:, None, None]
    track = dense_track(part, solution.x, cov)
    rows = np.searchsorted(track.t, part.instants.t)
    there = np.isin(part.instants.t, track.t)
    assert there.sum() > 10
    np.testing.assert_allclose(se2.between(track.pose[rows[there]], poses[there]), 0.0, atol=1e-9)
    np.testing.assert_allclose(track.cov[rows[there]], cov[there], atol=1e-9)
    steps = np.hypot(*np.diff(track.pose[:, :2], axis=0).T)
    assert (steps <= 0.6 * np.diff(track.t) + 1e-3).all()
    between = (track.t > part.instants.t[0]) & (track.t < part.instants.t[-1]) & ~np.isin(track.t, part.instants.t)
    share = np.interp(track.t[between], part.instants.t, np.arange(1.0, n + 1))
    np.testing.assert_allclose(track.cov[between, 0, 0], share, atol=1e-9)


def test_clean_logs_are_smoothed_to_the_truth_with_their_calibration():
    logs, landmarks, tracks = logs_and_map(noise=0.0)
    shifted = LandmarkMap(NAMES, POINTS + 0.03 * np.random.default_rng(1).normal(size=POINTS.shape), landmarks.cov)
    result = smooth(TeamMap(("robot1", "robot2"), shifted, tracks), logs, {}, CFG)
    assert not result.refused
    np.testing.assert_allclose(result.map.landmarks.mean, POINTS, atol=2e-3)
    for robot in ("robot1", "robot2"):
        found = result.calibration[robot]
        for name, true in zip(PARAMETERS, (1.0, 0.95, 0.15, 0.0, 1.0), strict=True):
            assert found[name][0] == pytest.approx(true, abs=0.01), name
        truth = se2.interpolate(result.map.tracks[robot].t, tracks[robot].t, tracks[robot].pose)
        assert np.abs(se2.between(truth, result.map.tracks[robot].pose)).max() < 0.02


@pytest.mark.parametrize(("kinds", "refused"), [((), True), (("scan",), True), (("scan", "landmark"), False)])
def test_a_team_tied_by_scans_alone_keeps_the_map_of_the_filters(monkeypatch, kinds, refused):
    logs, landmarks, tracks = logs_and_map()
    monkeypatch.setattr(
        "mapweave.team.smooth.team_problem",
        lambda *told, **more: replace(team_problem(*told, **more), used=dict.fromkeys(kinds, 9)),
    )
    made = smooth(TeamMap(("robot1", "robot2"), landmarks, tracks, {}, {}), logs, {}, CFG)
    assert (made.refused == "nobody saw a landmark of the map or another robot") is refused
    assert (made.map.landmarks is landmarks) is refused


def test_a_solution_that_ran_away_is_refused_though_its_numbers_are_finite(monkeypatch):
    logs, landmarks, tracks = logs_and_map()
    monkeypatch.setattr(
        TeamProblem, "solve", lambda problem, *told: replace(SOLVE(problem, *told), status=SolveStatus.DIVERGED)
    )
    made = smooth(TeamMap(("robot1", "robot2"), landmarks, tracks, {}, {}), logs, {}, CFG)
    assert made.refused == "the problem of the whole team is diverged"
    assert made.map.landmarks is landmarks


def test_a_sighting_weighs_one_over_its_deviations(solved):
    team, _ = solved
    seen = [term for term in team.problem.terms if term.name in {"landmark", "robot"}]
    assert seen
    for term in seen:
        floor, bearing = (
            (CFG.camera.range_floor, CFG.camera.bearing)
            if term.name == "landmark"
            else (CFG.camera.robot_range_floor, CFG.camera.robot_bearing)
        )
        np.testing.assert_allclose(term.sqrt_info[:, 1], 1.0 / bearing)
        assert (term.sqrt_info[:, 0] <= 1.0 / floor).all()
        assert (term.sqrt_info[:, 0] >= 1.0 / np.hypot(floor, CFG.camera.range_share * 10.0)).all()


def test_a_pose_a_landmark_and_a_calibration_are_each_eliminated_as_one():
    node = _nodes(6 + 4 + 2 * len(PARAMETERS), 6, 10)
    sizes = [3, 3, 2, 2, len(PARAMETERS), len(PARAMETERS)]
    assert np.array_equal(np.unique(node, return_inverse=True)[1], np.repeat(np.arange(6), sizes))


def test_a_parameter_is_observed_where_the_data_told_clearly_more_than_was_known():
    prior = {"lag": (0.15, 0.1)}
    assert is_observed("lag", 0.05, prior)
    assert not is_observed("lag", 0.09, prior)
    assert CalibrationPrior().lag_sd == 0.1
