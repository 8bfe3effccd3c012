"""Local maps of lines, and Gauss-Newton steps against them, equal dense algebra."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.laser.local_map import (
    MatchCost,
    ScanPoints,
    add_points,
    align_scan,
    count_matches,
    fit_lines,
    nearest_cell,
    rotate_information,
    solve3,
)
from mapweave.kernels.laser.refine import ScanCost, refine, stepped
from mapweave.kernels.laser.tiles import NearestRule, score
from mapweave.laser.particle_grid import CellConfig, ParticleGrid

pytestmark = pytest.mark.kernel

CELL, SIZE, KAPPA, ALPHA, AGREE = 0.25, 32, 0.1, 0.3, 0.5


def walls(rng, n=220):
    """Points on two slanted walls, 1.4 m long each, their normals towards the origin, and features."""
    u = rng.uniform(0, 1, n)[:, None]
    first = np.arange(n) % 2 == 0
    points = np.where(first[:, None], [1.2, -0.6] + u * [0.3, 1.4], [-0.9, 1.1] + u * [1.4, 0.2])
    points = points + 0.01 * rng.normal(size=(n, 2))
    normal = np.where(first[:, None], [-1.4, 0.3], [0.2, -1.4])
    return points, normal / np.hypot(*normal.T)[:, None], np.where(first, 0.3, 0.7) + 0.1 * rng.normal(size=n)


def built(points, normals, q):
    sums, lines = np.zeros((SIZE, SIZE, 9), np.float32), np.zeros((SIZE, SIZE, 6), np.float32)
    add_points(sums, CELL, points, normals, q, 1.0)
    fit_lines(sums, lines, CELL, points)
    return sums, lines


def test_a_cell_holds_its_mean_and_the_line_through_the_nine_cells_around_it():
    points, normals, q = walls(np.random.default_rng(0))
    _, lines = built(points, normals, q)
    index = np.floor(points / CELL).astype(int)
    for cell in np.unique(index, axis=0):
        own = (index == cell).all(axis=1)
        got = lines[cell[1] % SIZE, cell[0] % SIZE]
        np.testing.assert_allclose(got[:2], (points[own] - cell * CELL).mean(axis=0), atol=1e-5)
        np.testing.assert_allclose(got[4], q[own].mean(), atol=1e-5)
        facing = normals[own].sum(axis=0)
        around = np.zeros(len(points), dtype=bool)
        for other in np.unique(index[(np.abs(index - cell) <= 1).all(axis=1)], axis=0):
            there = (index == other).all(axis=1)
            if normals[there].sum(axis=0) @ facing >= 0:
                around |= there
        if around.sum() < 3:
            assert not got[[2, 3, 5]].any()
            continue
        values, vectors = np.linalg.eigh(np.cov(points[around].T, bias=True))
        normal = vectors[:, 0] * np.sign(vectors[:, 0] @ normals[around].sum(axis=0))
        np.testing.assert_allclose(got[2:4], normal, atol=2e-3)
        assert got[5] == pytest.approx((values[1] - values[0]) / values.sum(), abs=1e-3)
    assert lines.any(axis=2).sum() == len(np.unique(index, axis=0))


def test_points_taken_out_again_leave_the_map_as_it_was():
    rng = np.random.default_rng(1)
    points, normals, q = walls(rng)
    sums, lines = built(points[:150], normals[:150], q[:150])
    before = sums.copy(), lines.copy()
    add_points(sums, CELL, points[150:], normals[150:], q[150:], 1.0)
    fit_lines(sums, lines, CELL, points[150:])
    assert np.abs(sums - before[0]).max() > 0.5
    add_points(sums, CELL, points[150:], normals[150:], q[150:], -1.0)
    fit_lines(sums, lines, CELL, points[150:])
    np.testing.assert_allclose(sums, before[0], atol=1e-4)
    np.testing.assert_allclose(lines[..., :2], before[1][..., :2], atol=1e-4)


def found(lines, at, normal, q):
    """The cell of least distance, feature included, among the nine around, by trying each."""
    best = None
    for a in (-1, 0, 1):
        for b in (-1, 0, 1):
            cell = np.floor(at / CELL).astype(int) + np.array([b, a])
            x, y, nx, ny, feature, like = lines[cell[1] % SIZE, cell[0] % SIZE].astype(float)
            if nx * normal[0] + ny * normal[1] < AGREE:
                continue
            d = at - cell * CELL - [x, y]
            D = d @ d + ALPHA * (q - feature) ** 2
            if best is None or best[0] > D:
                best = (D, d, np.array([nx, ny]), like)
    return best


def test_the_nearest_cell_is_the_one_of_least_distance_whose_normal_agrees():
    rng = np.random.default_rng(2)
    points, normals, q = walls(rng)
    _, lines = built(points, normals, q)
    none = 0
    for k in range(80):
        at = points[k] + rng.normal(0, 0.15, 2)
        normal = se2.rotation(rng.normal(0, 0.9)) @ normals[k]
        want = found(lines, at, normal, q[k])
        D, dx, dy, nx, ny, like = nearest_cell(lines, CELL, *at, *normal, q[k], ALPHA, AGREE, np.inf)
        if want is None:
            assert np.inf == D
            none += 1
            continue
        np.testing.assert_allclose([D, dx, dy, nx, ny, like], [want[0], *want[1], *want[2], want[3]], atol=1e-5)
    assert 5 < none < 60


def test_past_the_end_of_a_wall_that_was_seen_a_return_is_of_nothing_known():
    x = np.arange(0.0, 1.0, 0.02)
    _, lines = built(np.column_stack([x, np.full_like(x, 0.1)]), np.tile([0.0, 1.0], (len(x), 1)), np.zeros(len(x)))
    for q, alpha in ((0.0, 0.0), (0.6, 1.0)):  # what it is told by may not bring it back
        for beyond, known in ((-0.05, True), (0.05, True), (0.2, False)):
            D = nearest_cell(lines, CELL, 1.0 + beyond, 0.15, 0.0, 1.0, q, alpha, AGREE, 0.25)[0]
            assert np.isfinite(D) == known
            assert np.isfinite(nearest_cell(lines, CELL, 1.0 + beyond, 0.15, 0.0, 1.0, q, alpha, AGREE, 1.0)[0])


def scan(rng, n=40):
    points, normals, q = walls(rng, n)
    T = np.array([0.1, -0.05, 0.2])
    return se2.act(se2.inverse(T), points), normals @ se2.rotation(0.2), q, T


def dense_step(lines, s, normal, q, pose, predicted, sd, information, tangent):
    """One Gauss-Newton step with robust weights held: the pose after it, H before it in the map's axes, the cost."""
    H, g, cost, h = np.zeros((3, 3)), np.zeros(3), 0.0, 1e-6
    for k in range(len(s)):
        cell = found(lines, se2.act(pose, s[k]), se2.rotation(float(pose[2])) @ normal[k], q[k])
        if cell is None:
            cost += information / len(s) * KAPPA**2
            continue
        _, d, m, like = cell
        J = np.array([(se2.act(pose + h * e, s[k]) - se2.act(pose - h * e, s[k])) / (2 * h) for e in np.eye(3)]).T
        for direction, share in ((m, 1.0), (np.array([m[1], -m[0]]), tangent)):
            e = direction @ d
            w = information / len(s) * share * like * (KAPPA**2 / (KAPPA**2 + e**2)) ** 2
            H += w * np.outer(direction @ J, direction @ J)
            g += w * e * (direction @ J)
        e = m @ d
        cost += information / len(s) * e**2 * KAPPA**2 / (KAPPA**2 + e**2)
    C = se2.turn(float(predicted[2]))
    W = C @ np.diag(sd**-2.0) @ C.T
    off = pose - predicted
    off[2] = se2.wrap_angle(off[2])
    H, g, cost = H + W, g + W @ off, cost + off @ W @ off
    return pose - np.linalg.solve(H, g), H, cost


@pytest.mark.parametrize("tangent", [0.0, 0.4])
def test_a_step_of_scan_matching_is_the_dense_one(tangent):
    rng = np.random.default_rng(3)
    _, lines = built(*walls(rng))
    s, normal, q, T = scan(rng)
    sd, information = np.array([0.05, 0.2, 0.04]), 60.0 / 0.02**2
    for turn in (0.0, 2 * np.pi):
        predicted = T + np.array([0.04, -0.07, 0.06 + turn])
        start = T + np.array([0.03, 0.02, 0.03])
        pose, H, cost = align_scan(
            lines,
            CELL,
            ScanPoints(s, normal, q, np.zeros(len(q))),
            MatchCost(ALPHA, AGREE, information, tangent, KAPPA, np.inf),
            start,
            predicted,
            sd,
            1,
        )
        wanted, dense, dense_cost = dense_step(lines, s, normal, q, start, predicted, sd, information, tangent)
        np.testing.assert_allclose(pose, wanted, atol=1e-5)
        R = se2.turn(float(pose[2]))
        np.testing.assert_allclose(H, R.T @ dense @ R, rtol=1e-4, atol=1e-3 * dense.max())
        np.testing.assert_allclose(H, H.T)
        assert cost == pytest.approx(dense_cost, rel=1e-4)


def test_a_match_walks_to_where_its_own_step_is_nothing():
    rng = np.random.default_rng(4)
    _, lines = built(*walls(rng))
    s, normal, q, T = scan(rng)
    sd = np.array([0.3, 0.3, 0.3])
    at = (
        lines,
        CELL,
        ScanPoints(s, normal, q, np.zeros(len(q))),
        MatchCost(ALPHA, AGREE, 60.0 / 0.02**2, 0.1, KAPPA, np.inf),
    )
    pose, _, cost = align_scan(*at, T + np.array([0.05, -0.04, 0.04]), T, sd, 60)
    _, _, there = align_scan(*at, T, T, sd, 1)
    assert np.abs(se2.between(T, pose)).max() < 0.03
    again, _, _ = align_scan(*at, pose, T, sd, 1)
    assert np.abs(again - pose).max() < 2e-5
    assert cost < 1.05 * there


@pytest.mark.parametrize("turn", [0.0, 0.5 * np.pi])
def test_a_match_against_one_wall_walks_on_while_it_still_moves_towards_it(turn):
    u = np.linspace(-0.9, 0.9, 40)
    R = se2.rotation(turn)
    wall, facing = np.column_stack([np.full(40, 1.13), u]) @ R.T, np.tile([-1.0, 0.0], (40, 1)) @ R.T
    _, lines = built(wall, facing, np.zeros(40))
    cost = MatchCost(ALPHA, AGREE, 60.0 / 0.02**2, 0.0, 0.05, np.inf)
    start = np.array([*(R @ [0.08, 0.0]), 0.0])
    ends = [
        align_scan(
            lines, CELL, ScanPoints(wall, facing, np.zeros(40), np.zeros(40)), cost, start, start, np.full(3, 5.0), n
        )[0]
        for n in (1, 2, 60)
    ]
    left = [np.hypot(*end[:2]) for end in ends]
    assert left[0] > 1.1 * left[1] > 0
    assert left[2] < 1e-3


def test_matches_are_points_within_reach_of_their_line():
    rng = np.random.default_rng(5)
    _, lines = built(*walls(rng))
    s, normal, q, T = scan(rng)
    s = s + rng.normal(0, 0.08, s.shape)
    count = 0
    for k in range(len(s)):
        cell = found(lines, se2.act(T, s[k]), se2.rotation(float(T[2])) @ normal[k], q[k])
        count += cell is not None and abs(cell[1] @ cell[2]) < 0.05
    assert 5 < count < 38
    assert count_matches(lines, CELL, s, normal, q, ALPHA, AGREE, T, 0.05) == count


def test_three_unknowns_are_solved_and_what_is_no_minimum_moves_nothing():
    rng = np.random.default_rng(6)
    root = rng.normal(size=(3, 3))
    A, b = root @ root.T, rng.normal(size=3)
    upper = A[np.triu_indices(3)]
    np.testing.assert_allclose(solve3(*upper, *b), np.linalg.solve(A, b), rtol=1e-9)
    np.testing.assert_allclose(rotate_information(A, root), root.T @ A @ root)
    for bad in (np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), np.diag([1.0, 1, -1])):
        assert solve3(*bad[np.triu_indices(3)], *b) == (0.0, 0.0, 0.0)


def test_a_step_of_refining_a_particle_is_the_dense_one_against_its_own_map():
    rng = np.random.default_rng(7)
    points, _, q = walls(rng)
    grid = ParticleGrid(2, CellConfig(size=CELL))
    laid = np.column_stack([points, q]).astype(np.float32)
    grid.insert(np.arange(2), np.array([[0.0, 0, 0], [0.03, 0.05, 0.02]]), laid, np.ones(len(points), np.float32))
    s, normal, feature, T = scan(rng)
    s, feature = s.astype(np.float32), feature.astype(np.float32)
    root = rng.normal(size=(3, 3))
    prior, cap, information, tangent = 200.0 * root @ root.T, 0.09, 60.0 / 0.03**2, 0.3
    starts = T + np.array([[0.04, 0.03, 0.03], [-0.02, 0.05, -0.04]])

    feet, least = np.column_stack([s, feature]).astype(np.float32), np.empty((2, len(s)), np.float32)

    def refined(iterations):
        return refine(
            grid.tile_maps, np.arange(2), starts, feet, normal,
            NearestRule(ALPHA, cap), ScanCost(information, tangent, KAPPA), prior, iterations, least,
        )  # fmt: skip

    def step(which, pose):
        cells = grid.cells(which).astype(float)
        index = np.floor(cells[:, :2] / CELL).astype(int)
        H, g, h = np.zeros((3, 3)), np.zeros(3), 1e-6
        for k in range(len(s)):
            at = se2.act(pose, s[k].astype(float))
            near = (np.abs(index - np.floor(at / CELL).astype(int)) <= 1).all(axis=1)
            D = np.square(cells[near, :2] - at).sum(axis=1) + ALPHA * (cells[near, 2] - feature[k]) ** 2
            if not len(D) or D.min() >= cap:
                continue
            d = at - cells[near][np.argmin(D), :2]
            J = np.array([(se2.act(pose + h * e, s[k]) - se2.act(pose - h * e, s[k])) / (2 * h) for e in np.eye(3)]).T
            m = se2.rotation(float(pose[2])) @ normal[k]
            for direction, share in ((m, 1.0), (np.array([-m[1], m[0]]), tangent)):
                e = direction @ d
                w = information / len(s) * share * (KAPPA**2 / (KAPPA**2 + e**2)) ** 2
                H += w * np.outer(direction @ J, direction @ J)
                g += w * e * (direction @ J)
        C = se2.turn(float(starts[which, 2]))
        W = C @ prior @ C.T
        return pose - np.linalg.solve(H + W, g + W @ (pose - starts[which]))

    for which in range(2):
        once = step(which, starts[which])
        np.testing.assert_allclose(refined(1)[which], once, atol=2e-5)
        np.testing.assert_allclose(refined(2)[which], step(which, once), atol=1e-4)
    np.testing.assert_array_equal(refined(0), starts)
    weighed = np.empty_like(least)
    score(grid.tile_maps, np.arange(2), starts, feet, NearestRule(ALPHA, cap), weighed)
    np.testing.assert_array_equal(least, weighed)


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_the_dense_one_of_what_beams_say_here_and_the_start_says_in_its_own_axes(seed):
    rng = np.random.default_rng(seed)
    start, off = rng.uniform(-2, 2, 3), rng.normal(0, 0.3, 3)
    pose = start + off
    A, B, g = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=3)
    H, prior = A @ A.T + 0.3 * np.eye(3), 3.0 * B @ B.T
    sums = (*H[np.triu_indices(3)], *g)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    here, there = se2.turn(float(pose[2])), se2.turn(float(start[2]))
    W = there @ prior @ there.T
    wanted = pose - np.linalg.solve(here @ H @ here.T + W, here @ g + W @ off)
    np.testing.assert_allclose(stepped(*pose, *start, c, s, prior, sums), wanted, atol=1e-9)
