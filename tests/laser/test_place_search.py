"""Where a scan fits in a place: branch and bound against trying every pose, refinement, submaps."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.core.records import frozen
from mapweave.kernels.laser.place_search import fit_normals, lay_onto_lines
from mapweave.laser.place_search import (
    FULL,
    PLACE_APART,
    PLACE_APART_TURN,
    Q_LEVELS,
    PlaceConfig,
    Window,
    brightness,
    everywhere,
    gathered,
    headings,
    likelihood_field,
    query_around,
    refine,
    search,
    voxelled,
)


def walls(rng: np.random.Generator, count: int = 8, size: float = 6.0) -> np.ndarray:
    """Points along random straight walls."""
    ends = rng.uniform(-size, size, (count, 2, 2))
    t = np.linspace(0.0, 1.0, 40)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in ends])


def scores(field, points, window, q):
    """Whole-number scores of every pose of the window, (headings, ys, xs), from the definition."""
    cfg = field.cfg
    turns = headings(window, cfg.turn)
    nx, ny = (int(np.floor(r / cfg.cell + 1e-9)) for r in window.reach)
    ox, oy = np.arange(-nx, nx + 1), np.arange(-ny, ny + 1)
    table = field.tables[0][2**cfg.levels - 1 :, 2**cfg.levels - 1 :].astype(np.int64)
    out = np.zeros((len(turns), len(oy), len(ox)), np.int64)
    for a, turn in enumerate(turns):
        c, s = np.cos(turn), np.sin(turn)
        x = window.centre[0] + c * points[:, 0] - s * points[:, 1]
        y = window.centre[1] + s * points[:, 0] + c * points[:, 1]
        col = np.floor((x - field.origin[0]) / cfg.cell).astype(int)[:, None, None] + ox
        row = np.floor((y - field.origin[1]) / cfg.cell).astype(int)[:, None, None] + oy[:, None]
        inside = (col >= 0) & (col < table.shape[1]) & (row >= 0) & (row < table.shape[0])
        at = np.where(inside, row, 0), np.where(inside, col, 0)
        value = np.where(inside, table[at], 0)
        if q is not None and field.q is not None:
            there = brightness(field.q)[np.maximum(field.nearest[at], 0)].astype(float)
            d = (brightness(q)[:, None, None] - there) / Q_LEVELS * cfg.q_weight
            value = value * np.floor(FULL * np.exp(-0.5 * (d / cfg.sigma) ** 2) + 0.5).astype(np.int64)
        out[a] = value.sum(axis=0)
    return turns, oy, ox, out


def best_of(score, allowed):
    """Flat number of the first of the greatest allowed."""
    return int(np.argmax(np.where(allowed, score, -1)))


@pytest.mark.parametrize("block", range(10))
def test_the_search_finds_what_trying_every_pose_finds(block):
    for case in range(20):
        rng = np.random.default_rng([block, case])
        place = walls(rng)
        featured = case % 3 == 0
        q = rng.uniform(0.0, 1.2, len(place)) if featured else None
        cfg = PlaceConfig(levels=int(rng.integers(1, 5)), turn=float(rng.uniform(0.03, 0.2)))
        field = likelihood_field(place, q, cfg)
        seen = rng.choice(len(place), 30, replace=False)
        truth = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-np.pi, np.pi)])
        points = se2.act(se2.inverse(truth), place[seen] + rng.normal(0.0, 0.05, (30, 2)))
        light = None if q is None else np.clip(q[seen] + rng.normal(0.0, 0.1, 30), 0.0, None)
        reach = (float(rng.uniform(0.0, 2.5)), float(rng.uniform(0.0, 2.5)))
        centre = se2.compose(truth, rng.uniform(-0.5, 0.5, 3))
        window = Window(centre, reach, float(rng.uniform(0.0, 4.0)))
        turns, oy, ox, score = scores(field, points, window, light)
        found = search(field, points, window, light)
        most = 255 * (FULL if featured else 1) * len(points)
        a, y, x = np.unravel_index(best_of(score, score > 0), score.shape)
        want = [centre[0] + ox[x] * cfg.cell, centre[1] + oy[y] * cfg.cell, se2.wrap_angle(turns[a])]
        assert found.best is not None
        assert found.best.score == score[a, y, x] / most
        assert np.array_equal(found.best.pose, want)
        near_turn = np.abs(se2.wrap_angle(turns - turns[a])) <= PLACE_APART_TURN
        near = (ox - ox[x]) ** 2 + (oy[:, None] - oy[y]) ** 2 <= int((PLACE_APART / cfg.cell) ** 2 + 1e-9)
        allowed = ~(near_turn[:, None, None] & near) & (score > 0)
        if not allowed.any():
            assert found.second is None
            continue
        b, v, u = np.unravel_index(best_of(score, allowed), score.shape)
        assert found.second is not None
        assert found.second.score == score[b, v, u] / most
        want = [centre[0] + ox[u] * cfg.cell, centre[1] + oy[v] * cfg.cell, se2.wrap_angle(turns[b])]
        assert np.array_equal(found.second.pose, want)


def test_thresholds_leave_out_only_what_scores_less():
    rng = np.random.default_rng(4)
    place = walls(rng)
    field = likelihood_field(place)
    points = place[::7] + rng.normal(0.0, 0.05, place[::7].shape)
    whole = search(field, points, everywhere(field))
    assert whole.best is not None
    assert whole.second is not None
    ratio = whole.second.score / whole.best.score
    assert whole.ratio == ratio
    held = search(field, points, everywhere(field), least=whole.best.score, least_ratio=ratio)
    assert held.best is not None
    assert np.array_equal(held.best.pose, whole.best.pose)
    assert search(field, points, everywhere(field), least_ratio=1.0001 * ratio).second is None
    assert search(field, points, everywhere(field), least=1.0001 * whole.best.score).best is None


def test_brightness_decides_where_walls_alone_cannot():
    """A flush wall with one bright stretch: geometry slides along it, brightness does not."""
    x = np.arange(-10.0, 10.0, 0.05)
    wall = np.concatenate([np.column_stack([x, np.full_like(x, s)]) for s in (-1.2, 1.2)])
    q = np.where(np.abs(wall[:, 0] - 3.0) < 0.6, 1.0, 0.4)
    seen = np.abs(wall[:, 0] - 2.5) < 3.0
    points = wall[seen][::3] - [2.5, 0.0]
    window = Window(np.array([1.0, 0.0, 0.0]), (3.0, 0.3), 0.1)
    blind = search(likelihood_field(wall), points, window)
    bright = search(likelihood_field(wall, q), points, window, q[seen][::3])
    assert blind.ratio > 0.98
    assert bright.ratio < 0.96
    assert bright.best is not None
    assert abs(bright.best.pose[0] - 2.5) <= 0.1
    fit = refine(likelihood_field(wall), points, np.array([2.4, 0.05, 0.01]))
    assert fit.held[0] < 0.02 * fit.held[1]
    assert abs(fit.weak[0]) > 0.99
    assert fit.covariance[0, 0] > 25 * fit.covariance[1, 1]


@pytest.mark.parametrize("turn", [0.0, 0.2, 0.25, 3.0, np.pi, 4.0])
@pytest.mark.parametrize("step", [0.05, 0.1, 0.11])
def test_headings_are_evenly_spaced_about_the_middle_and_of_a_full_circle_all_the_way_round(turn, step):
    found = headings(Window(np.array([1.0, 2.0, -2.5]), (1.0, 1.0), turn), step)
    if turn >= np.pi:
        gaps = np.diff([*found, found[0] + 2 * np.pi])
        np.testing.assert_allclose(gaps, gaps[0])
        assert step - step**2 / 6 < gaps[0] <= step
        return
    np.testing.assert_allclose(np.diff(found), step)
    np.testing.assert_allclose(found + found[::-1], -5.0)
    assert turn - step < found[-1] + 2.5 <= turn + 1e-12


def test_a_refined_pose_lies_within_its_own_covariance():
    rng = np.random.default_rng(2)
    place = walls(rng, 14)
    place = voxelled(place, 0.05)[0]
    field = likelihood_field(place)
    for _ in range(20):
        truth = np.array([*rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi)])
        seen = place[rng.choice(len(place), 200, replace=False)] + rng.normal(0.0, 0.02, (200, 2))
        points = se2.act(se2.inverse(truth), seen)
        fit = refine(field, points, truth + rng.uniform(-0.08, 0.08, 3) * [1.0, 1.0, 0.2])
        error = se2.between(fit.pose, truth)
        assert np.abs(error[:2]).max() < 0.02
        assert abs(error[2]) < 0.005
        assert error @ fit.information @ error < 12.0
        assert fit.share > 0.9
        assert fit.rms < 0.04


def test_a_query_is_what_the_keyframes_around_saw_in_the_frame_of_the_one_in_the_middle():
    rng = np.random.default_rng(3)
    place = walls(rng, 14)
    poses = np.column_stack([np.linspace(-2.0, 2.0, 40), rng.uniform(-1.0, 1.0, 40), rng.uniform(-3.0, 3.0, 40)])
    clouds = [se2.act(se2.inverse(p), place[rng.choice(len(place), 60)]) for p in poses]
    query = query_around(poses, clouds, 25, 8, [np.full(60, 0.5) for _ in poses])
    back = se2.act(poses[25], query.points)
    distance = np.hypot(*(back[:, None] - place[None]).transpose(2, 0, 1)).min(axis=1)
    assert distance.max() < 0.15
    assert len(query.points) == 400
    assert np.allclose(query.q, 0.5)
    assert len(query_around(poses, clouds, 0, 1).points) < 121
    assert gathered(poses, clouds, [], poses[0], 0.1)[0].shape == (0, 2)


def test_places_nobody_can_search_are_refused():
    with pytest.raises(DataError, match="found none"):
        likelihood_field(np.zeros((0, 2)))
    with pytest.raises(DataError, match="finite"):
        likelihood_field(np.array([[0.0, np.nan]]))
    with pytest.raises(DataError, match="too large"):
        likelihood_field(np.array([[0.0, 0.0], [1e6, 1e6]]))
    field = likelihood_field(np.zeros((1, 2)))
    assert search(field, np.zeros((0, 2)), everywhere(field)).best is None
    with pytest.raises(DataError, match="at most"):
        search(field, np.zeros((2000, 2)), everywhere(field))


@pytest.mark.kernel
def test_a_field_is_the_likelihood_of_the_nearest_wall_point_as_far_as_it_matters():
    place = walls(np.random.default_rng(5), count=4, size=2.0)
    cfg = PlaceConfig()
    field = likelihood_field(place, None, cfg)
    pad = 2**cfg.levels - 1
    table = field.tables[0][pad:, pad:]
    rows, cols = np.indices(field.nearest.shape)
    centres = field.origin + cfg.cell * (np.stack([cols, rows], axis=-1) + 0.5)
    d = np.hypot(*np.moveaxis(centres[:, :, None] - place, -1, 0))
    far = max(3.0 * cfg.sigma, cfg.gate)
    near = d.min(axis=2) < far - cfg.cell
    beyond = d.min(axis=2) > 2.0 * far + 2.0 * cfg.cell
    assert near.any()
    assert beyond.any()
    value = 255 * np.exp(-0.5 * (d.min(axis=2) / cfg.sigma) ** 2)
    assert np.abs(table[: rows.shape[0], : cols.shape[1]][near] - value[near]).max() <= 1.0
    assert not table[: rows.shape[0], : cols.shape[1]][beyond].any()
    assert (field.nearest[beyond] == -1).all()
    chosen = np.take_along_axis(d, np.maximum(field.nearest, 0)[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(chosen[near], d.min(axis=2)[near], atol=1e-9)
    low, high = centres[0, 0], centres[-1, -1]
    assert (low <= place.min(axis=0) - far + cfg.cell).all()
    assert (high >= place.max(axis=0) + far - cfg.cell).all()


@pytest.mark.kernel
def test_lines_are_the_principal_axes_of_what_lies_around():
    points = walls(np.random.default_rng(6), count=5, size=1.5)
    lines = fit_normals(frozen(points), 0.3)
    for k in range(0, len(points), 7):
        around = points[np.hypot(*(points - points[k]).T) <= 0.3]
        values, vectors = np.linalg.eigh(np.cov(around.T, bias=True))
        assert abs(vectors[:, 0] @ lines[k, :2]) == pytest.approx(1.0, abs=1e-6) or values[0] > 0.9 * values[1]
        assert lines[k, 2] == pytest.approx(max(values[0], 0.0) / values[1], abs=1e-6)
    assert fit_normals(frozen([[0.0, 0.0], [9.0, 9.0]]), 0.3)[:, 2].tolist() == [1.0, 1.0]


@pytest.mark.kernel
def test_a_scan_is_laid_where_its_costs_pull_no_more_and_what_is_told_there_is_the_dense_sum():
    rng = np.random.default_rng(8)
    place = walls(rng, count=6, size=2.5)
    cfg = PlaceConfig()
    field = likelihood_field(place, None, cfg)
    truth = np.array([0.3, -0.2, 0.7])
    points = se2.act(se2.inverse(truth), place[::3] + rng.normal(0.0, 0.02, place[::3].shape))
    points[:3] += 5.0
    width, gate = 0.1, 0.2
    start = truth + np.array([0.05, -0.04, 0.02])
    pose, H, count, mean2 = lay_onto_lines(
        frozen(points), frozen(start), field.points, field.lines, field.nearest, field.origin, cfg.cell, gate,
        np.array([0.3, width]), 1e-7,
    )  # fmt: skip
    assert np.abs(se2.between(truth, pose)).max() < 0.02
    dense, g, found, squares, h = np.zeros((3, 3)), np.zeros(3), 0, 0.0, 1e-6
    for p in points:
        at = se2.act(pose, p)
        col, row = np.floor((at - field.origin) / cfg.cell).astype(int)
        if not (0 <= row < field.nearest.shape[0] and 0 <= col < field.nearest.shape[1]):
            continue
        k = field.nearest[row, col]
        if k < 0 or np.hypot(*(at - field.points[k])) > gate:
            continue
        d, (nx, ny, wide) = at - field.points[k], field.lines[k]
        steps = h * np.eye(3)
        J = np.array(
            [(se2.act(se2.compose(pose, e), p) - se2.act(se2.compose(pose, -e), p)) / (2 * h) for e in steps]
        ).T
        for direction, share in ((np.array([nx, ny]), 1.0), (np.array([ny, -nx]), wide)):
            e = direction @ d
            w = share * (width**2 / (width**2 + e**2)) ** 2
            dense, g = dense + w * np.outer(direction @ J, direction @ J), g + w * e * (direction @ J)
            squares += share * e**2
        found += 1
    assert count == found > 60
    assert mean2 == pytest.approx(squares / found, rel=1e-6)
    np.testing.assert_allclose(H, dense, rtol=1e-5, atol=1e-5 * dense.max())
    assert np.abs(np.linalg.solve(dense, g)).max() < 2e-3
