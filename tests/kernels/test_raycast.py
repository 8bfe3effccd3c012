"""Ray casting against an independent dense computation."""

import numpy as np
import pytest

from mapweave.core.walls import WallIndex
from mapweave.kernels.walls.segments import cast


def dense(pose, angle, segments, discs):
    """One beam by solving a 2 x 2 system a segment and a quadratic a disc."""
    p, u = pose[:2], np.array([np.cos(pose[2] + angle), np.sin(pose[2] + angle)])
    best = (np.inf, -1, 0.0)
    for k, (x0, y0, x1, y1) in enumerate(segments):
        e = np.array([x1 - x0, y1 - y0])
        A = np.column_stack([u, -e])
        if abs(np.linalg.det(A)) < 1e-12:
            continue
        r, along = np.linalg.solve(A, np.array([x0, y0]) - p)
        if 0 < r < best[0] and 0 <= along <= 1:
            normal = np.array([-e[1], e[0]]) / np.hypot(*e)
            best = (r, k, abs(normal @ u))
    for k, (x, y, radius) in enumerate(discs):
        roots = np.roots([1.0, 2 * u @ (p - [x, y]), (p - [x, y]) @ (p - [x, y]) - radius**2])
        if radius > 0 and np.isreal(roots).all() and 0 < roots.real.min() < best[0]:
            r = roots.real.min()
            normal = (p + r * u - [x, y]) / radius
            best = (r, len(segments) + k, abs(normal @ u))
    return best


@pytest.mark.kernel
def test_every_beam_hits_what_a_dense_computation_says():
    rng = np.random.default_rng(4)
    segments = rng.uniform(-4, 4, (12, 4))
    sensor = np.column_stack([rng.uniform(-2, 2, (4, 2)), rng.uniform(-3, 3, 4)])
    discs = np.concatenate([rng.uniform(-2, 2, (4, 2, 2)), np.tile([[[0.9], [0.0]]], (4, 1, 1))], axis=2)
    angles = np.linspace(-2, 2, 25)
    r, what, cosine = cast(sensor, angles, segments, discs, 20.0)
    hits = 0
    for i in range(4):
        for j in range(25):
            want = dense(sensor[i], angles[j], segments, discs[i])
            assert what[i, j] == want[1]
            if want[1] >= 0:
                hits += 1
                assert np.isclose(r[i, j], want[0])
                assert np.isclose(cosine[i, j], want[2])
            else:
                assert np.isinf(r[i, j])
    assert hits > 40
    assert (what >= 12).any()


@pytest.mark.kernel
def test_nothing_is_hit_beyond_the_reach():
    segments = np.array([[3.0, -5, 3, 5], [6, -50, 6, 50]])
    sensor = np.zeros((1, 3))
    r, what, _ = cast(sensor, np.array([0.0, np.pi]), segments[1:], np.zeros((1, 0, 3)), 5.0)
    assert (what == -1).all()
    r, what, _ = cast(sensor, np.array([0.0, np.pi]), segments, np.zeros((1, 0, 3)), 5.0)
    assert what.tolist() == [[0, -1]]
    assert r[0, 0] == 3.0


@pytest.mark.kernel
@pytest.mark.parametrize("wall", [[3.0, -1, 3, 400], [400.0, -400, -394, 400], [-300, -0.5, 300, 1.5]])
def test_a_long_wall_is_hit_though_its_middle_and_its_ends_are_out_of_reach(wall):
    segments = np.array([wall, [0.0, 90.0, 1.0, 90.0]], float)
    sensor = np.array([[0.0, 0.0, 0.3]])
    angles = np.linspace(-np.pi, np.pi, 37)
    r, what, cosine = cast(sensor, angles, segments, np.zeros((1, 0, 3)), 6.0)
    grid = WallIndex.of(segments).cast(sensor, angles, np.zeros((1, 0, 3)), 6.0)
    hits = 0
    for j, angle in enumerate(angles):
        want = dense(sensor[0], angle, segments, np.zeros((0, 3)))
        if want[0] < 6.0:
            hits += 1
            assert what[0, j] == want[1]
            assert np.isclose(r[0, j], want[0])
            assert np.isclose(cosine[0, j], want[2])
        else:
            assert np.isinf(r[0, j])
    assert hits >= 5
    assert np.array_equal(grid[1], what)
    np.testing.assert_allclose(grid[0], r)
