"""Poses against a finished map: the kernel against plain loops, and the nearest-cell table against brute force."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import frozen
from mapweave.kernels.laser.scan_laying import score_field
from mapweave.laser.laser_map import GridMap
from mapweave.laser.localise_trust import nearest_field


@pytest.mark.kernel
def test_scores_equal_a_plain_computation():
    rng = np.random.default_rng(2)
    near = rng.uniform(-1, 3, (20, 30, 3))
    origin, cell = np.array([-1.0, -0.5]), 0.1
    poses = np.column_stack([rng.uniform(-1, 2, (7, 2)), rng.uniform(-3, 3, 7)])
    points = np.column_stack([rng.uniform(-1, 1, (9, 2)), rng.uniform(0, 1, 9)])
    mean, matched = score_field(frozen(near), frozen(origin), cell, poses, points, 0.7, 2.0, 1.0)
    for p, pose in enumerate(poses):
        world = se2.act(pose, points[:, :2])
        index = np.floor((world - origin) / cell).astype(int)
        D = []
        for (col, row), w, q in zip(index, world, points[:, 2], strict=True):
            inside = 0 <= row < 20 and 0 <= col < 30
            n = near[row, col] if inside else np.full(3, np.inf)
            D.append(min(2.0, ((n[:2] - w) ** 2).sum() + 0.7 * (n[2] - q) ** 2))
        assert mean[p] == pytest.approx(np.mean(D))
        assert matched[p] == sum(d < 1.0 for d in D)


def test_the_table_names_the_nearest_occupied_cell_and_ignores_what_was_mostly_seen_through():
    rng = np.random.default_rng(3)
    hits = (rng.random((12, 17)) < 0.1) * 20
    passes = np.full((12, 17), 4)
    hits[5, 5], passes[5, 5] = 1, 50
    y, x = np.mgrid[0:12, 0:17]
    mean = np.stack([0.1 * x + 0.05, 0.1 * y + 0.05], axis=-1)
    grid = GridMap(0.1, np.zeros(2), hits, passes, mean, np.zeros((12, 17)), (hits > 0).astype(float))
    walls = nearest_field(grid, 0.3)
    rows, cols = np.nonzero((hits > 0) & (passes < 50))
    for row in range(12):
        for col in range(17):
            at = walls.near[row + 10, col + 10, :2]
            d = np.hypot(cols - col, rows - row).min() * 0.1
            assert np.hypot(*(at - mean[row, col])) == pytest.approx(d, abs=1e-6)
    empty = GridMap(0.1, np.zeros(2), hits * 0, passes, mean, np.zeros((12, 17)), np.zeros((12, 17)))
    with pytest.raises(ValueError, match="no cell"):
        nearest_field(empty, 0.3)
