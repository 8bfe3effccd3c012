"""Walls in buckets: the same answers as asking every wall."""

import numpy as np
import pytest

from mapweave.core.wall_index import WallIndex
from mapweave.kernels.walls.raycast import cast


def clutter(seed, many):
    """Slanted and axis-parallel walls, some on the borders of buckets."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(-6, 6, (many, 2))
    slanted = np.hstack([a, a + rng.uniform(-2, 2, (many, 2))])
    x, y = rng.integers(-6, 6, (2, many)).astype(float)
    return np.vstack([slanted, np.column_stack([x, y, x + 2, y]), np.column_stack([x, y, x, y + 1])])


@pytest.mark.kernel
def test_beams_end_where_asking_every_wall_says():
    walls = clutter(1, 8)
    rng = np.random.default_rng(2)
    sensor = np.vstack([rng.uniform(-9, 9, (12, 3)), [[0.0, 0.0, 0.0], [-3.0, 2.0, np.pi / 2]]])  # some on borders
    discs = np.tile([[[1.0, 1.0, 0.4], [-2.0, 0.5, 0.0]]], (len(sensor), 1, 1))
    angles = np.linspace(-np.pi, np.pi, 41)
    want = cast(sensor, angles, walls, discs, 7.0)
    got = WallIndex.of(walls).cast(sensor, angles, discs, 7.0)
    assert np.isfinite(want[0]).sum() > 100
    assert (want[1] >= len(walls)).any()
    for a, b in zip(got, want, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.kernel
def test_a_world_without_walls_is_seen_as_empty():
    empty = WallIndex.of(np.zeros((0, 4)))
    r, what, _ = empty.cast(np.zeros((1, 3)), np.zeros(3), np.zeros((1, 0, 3)), 5.0)
    assert np.isinf(r).all()
    assert (what == -1).all()
    assert not empty.touches(np.zeros((1, 2)), 1.0).any()


@pytest.mark.kernel
def test_a_disc_touches_exactly_the_walls_nearer_than_its_radius():
    walls = clutter(3, 5)
    points = np.random.default_rng(4).uniform(-8, 8, (150, 2))
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    along = np.clip(((points[:, None] - a) * e).sum(-1) / (e**2).sum(-1), 0, 1)
    nearest = np.hypot(*np.moveaxis(a + along[..., None] * e - points[:, None], -1, 0)).min(axis=1)
    touches = WallIndex.of(walls).touches(points, 0.7)
    assert touches.any()
    assert not touches.all()
    assert np.array_equal(touches, nearest < 0.7)
