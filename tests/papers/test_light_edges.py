"""Rims of posters and doors as landmarks, and how little can be known without them."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.laser.beam import beams
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature
from mapweave.papers.hara.experiments import along_flush_walls, geometry_bound, light_bound, score
from mapweave.papers.hara.light_edges import find_rims, rim_problem, same_rims, sharpened
from mapweave.sim.laser import DriftConfig, DriveConfig
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

LOOP = CorridorConfig(long_leg=40.0, short_leg=10.0, distance=30.0, start=8.0)


@pytest.fixture(scope="module")
def drive():
    sim = simulate_corridor(LOOP, 50)
    feature = choose_feature(sim.log, LaserConfig())
    seen = [beams(s, feature.name, feature.calibration, LaserConfig().beam) for s in sim.log.scans]
    truth = sim.truth.pose[np.searchsorted(sim.truth.t, sim.log.scan_t)]
    return sim, seen, truth, feature.calibration.residual


def test_rims_stand_where_reflectance_changes_and_are_seen_in_one_place(drive):
    sim, seen, truth, noise = drive
    rims = find_rims(seen, noise)
    a, b = sim.world.segments[:, :2], sim.world.segments[:, 2:]
    ends = np.concatenate([a, b])
    world = se2.act(truth[rims.scan], rims.point)
    off = np.min(np.hypot(*(world[:, None] - ends).transpose(2, 0, 1)), axis=1)
    assert np.median(off) < 0.02
    one = same_rims(rims, truth, 0.1)
    count = np.bincount(one)
    mean = np.column_stack([np.bincount(one, world[:, k]) / count for k in range(2)])
    assert np.median(np.hypot(*(world - mean[one]).T)) < 0.02
    assert np.median(count[one]) > 10
    for scan in (10, 50):
        assert len(np.unique(one[rims.scan == scan])) == np.sum(rims.scan == scan)


def test_poses_off_along_the_walls_are_put_right_by_rims_and_not_by_walls(drive):
    sim, seen, truth, noise = drive
    wrong = truth.copy()
    wrong[:, 0] += 0.15 * np.sin(0.4 * np.arange(len(truth)) * 0.25)

    def error(poses):
        return score(Track(sim.log.scan_t, poses, frame="map"), sim.truth)

    bare = [b._replace(q=np.ones_like(b.q)) for b in seen]
    assert error(sharpened(seen, wrong, noise)) < 0.25 * error(wrong)
    assert error(sharpened(bare, wrong, noise)) > 0.8 * error(wrong)


def test_the_jacobian_of_a_rim_equals_finite_differences(drive):
    _, seen, truth, noise = drive
    rims = find_rims(seen[:6], noise)
    asked = rim_problem(rims, same_rims(rims, truth[:6], 0.1), truth[:6], ())
    factor = replace(asked.terms[0], sqrt_info=None)
    x = asked.x0 + np.random.default_rng(0).normal(0, 0.05, len(asked.x0))
    J = factor.jacobian(x)
    for c in range(5):
        d = np.zeros((len(factor.columns), 2))
        for m, column in enumerate(factor.columns[:, c].tolist()):
            step = np.zeros(len(x))
            step[column] = 1e-6
            d[m] = (factor.residual(x + step)[m] - factor.residual(x - step)[m]) / 2e-6
        assert np.allclose(J[:, :, c], d, atol=1e-6)


def test_the_bound_on_geometry_is_what_the_noise_of_wheels_leaves_between_corners():
    """White noise alone, one long leg driven: the variance after s metres is that of a walk of s."""
    drift = DriftConfig(scale=0.0, translation=0.02, end_error=None)
    cfg = CorridorConfig(long_leg=80.0, short_leg=10.0, distance=40.0, start=20.0, drive=DriveConfig(drift=drift))
    sim = simulate_corridor(cfg, 1)
    truth = sim.truth.pose[np.searchsorted(sim.truth.t, sim.log.scan_t)]
    assert along_flush_walls(truth, cfg).all()
    n = len(truth)
    walk = 0.02**2 * 40.0 * np.minimum.outer(np.arange(n), np.arange(n)) / (n - 1)
    centred = walk - walk.mean(axis=0)
    centred -= centred.mean(axis=1)[:, None]
    assert geometry_bound(sim, cfg) == pytest.approx(np.sqrt(np.trace(centred) / n), rel=1e-6)
    within = CorridorConfig(long_leg=8.0, short_leg=8.0, distance=20.0, start=3.0)
    assert geometry_bound(simulate_corridor(within, 1), within) == 0.0


def test_the_bound_with_light_is_a_centimetre_or_two_and_far_below_that_on_geometry(drive):
    sim, *_ = drive
    bound = light_bound(sim, 0)
    assert 0.001 < bound < 0.04
    assert bound < 0.5 * geometry_bound(sim, LOOP)
