"""The e-puck worlds and unequal maps: laid out as said, and filters as good as they say when nothing is misstated."""

from itertools import pairwise

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.papers.kojima.experiments import (
    KOJIMA_ARENA,
    KOJIMA_RADIUS,
    SEEN,
    UNEQUAL_LARGEST,
    UNEQUAL_SMALLEST,
    KojimaConfig,
    draw_unequal,
    draw_worlds,
    run_filters,
)


def test_worlds_are_laid_out_as_said_and_the_same_seed_gives_the_same():
    KojimaConfig()
    worlds, again = (draw_worlds(50, np.random.default_rng(0)) for _ in range(2))
    assert np.array_equal(worlds.landmarks, again.landmarks)
    p = worlds.landmarks
    d = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1) + 9 * np.eye(8)
    assert d.min() >= 0.2
    assert d[:, 0, 1].min() >= 0.4
    x = p[..., 0] + 0.5 * KOJIMA_ARENA - 0.35  # frame 1 starts below the left circle's centre
    assert ((x[:, :2] > 0.55) & (x[:, :2] < 0.95)).all()
    assert (x[:, 2:5] < 0.55).all()
    assert (x[:, 5:] > 0.95).all()
    for k, side in enumerate((1.0, -1.0)):
        centre = se2.act(worlds.start[:, k], np.array([0.0, side * KOJIMA_RADIUS]))
        path = np.abs(np.linalg.norm(p - centre[:, None], axis=-1) - KOJIMA_RADIUS)
        assert path.min() > 0.08 - 1e-12


def test_robots_stop_after_the_drive_and_their_maps_go_on_to_the_last_step():
    cfg = KojimaConfig(drive_steps=20, steps=30)
    worlds = draw_worlds(3, np.random.default_rng(1))
    maps = list(run_filters(cfg, worlds, np.random.default_rng(2)))
    assert len(maps) == 11
    for before, after in pairwise(maps):
        assert (np.linalg.slogdet(after.cov)[1] < np.linalg.slogdet(before.cov)[1]).all()


def test_local_maps_are_consistent_when_the_filter_is_told_the_truth_about_its_noise():
    cfg = KojimaConfig(filter_variance=1e-4, first_pose_variance=0.0, drive_steps=300, steps=300)
    worlds = draw_worlds(150, np.random.default_rng(3))
    (local,) = run_filters(cfg, worlds, np.random.default_rng(4))
    own = se2.act(se2.inverse(worlds.start[:, 1])[:, None], worlds.landmarks[:, SEEN[1]])
    e = (local.mean - np.stack([worlds.landmarks[:, SEEN[0]], own], axis=1)).reshape(150, 2, 10, 1)
    nees = np.sum(e * np.linalg.solve(local.cov, e), axis=(-1, -2)) / 10
    assert nees.mean() == pytest.approx(1.0, abs=0.12)


def test_unequal_maps_err_as_their_covariances_say():
    worlds = draw_unequal(500, np.random.default_rng(5))
    assert worlds.landmarks.shape == (500, 14, 2)
    assert np.intersect1d(*worlds.index).tolist() == list(range(6))
    own = se2.act(se2.inverse(worlds.frame)[:, None], worlds.landmarks[:, worlds.index[1]])
    e = (worlds.mean - np.stack([worlds.landmarks[:, worlds.index[0]], own], axis=1)).reshape(500, 2, 20)
    sigma = np.sqrt(worlds.cov[..., np.arange(20), np.arange(20)])
    assert np.mean((e / sigma) ** 2) == pytest.approx(1.0, abs=0.03)
    assert UNEQUAL_SMALLEST <= sigma.min() < sigma.max() <= UNEQUAL_LARGEST
