"""What intensity is worth on the 200 m loop, in the small; `benchmarks/corridor.py` runs it whole."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.laser import particle_slam
from mapweave.laser.beam import IntensityCalibration, beams
from mapweave.laser.laser_map import ScanInfos
from mapweave.laser.particle_grid import ParticleGrid
from mapweave.laser.particle_slam import as_points, log_likelihood
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature, finish, map_laser
from mapweave.papers.hara.experiments import score
from mapweave.sim.laser import SECOND_LAW, DriveConfig
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

LOOP = CorridorConfig(long_leg=25.0, short_leg=12.0, distance=85.0, start=6.0)
CFG = LaserConfig(method="particle", particles=64, threads=1)
KNOTS = np.linspace(0.0, 6.0, 31)
LAW = IntensityCalibration(KNOTS, -np.log1p((KNOTS / 1.5) ** 2), 1.0, 40000 * 0.9, 0.0, 1)  # the simulator's own


def errors(sim, **more):
    made = map_laser(sim.log, replace(CFG, **more), 0)
    return score(made.track, sim.truth), score(made.dead_reckoning, sim.truth)


@pytest.mark.slow
def test_intensity_closes_a_loop_that_geometry_and_odometry_do_not():
    sim = simulate_corridor(LOOP, seed=31)
    seen, odometry = errors(sim)
    blind, _ = errors(sim, feature="none")
    assert seen <= 0.40 * blind
    assert seen <= 0.05 * odometry
    assert seen <= 0.30


def test_a_reflectance_law_the_estimator_was_not_told_does_no_harm():
    world = CorridorConfig(long_leg=25.0, short_leg=12.0, distance=85.0, start=6.0, drive=DriveConfig(law=SECOND_LAW))
    seen, odometry = errors(simulate_corridor(world, seed=31))
    assert seen <= 0.30
    assert seen <= 0.05 * odometry


@pytest.mark.slow
def test_a_self_calibrated_feature_maps_as_well_as_the_true_law():
    sim = simulate_corridor(LOOP, seed=32)
    own, _ = errors(sim)
    found = replace(choose_feature(sim.log, CFG), calibration=LAW)
    told = score(mapped_by(sim, found, CFG).track, sim.truth)
    assert own <= max(1.5 * told, 0.15)


def mapped_by(sim, feature, cfg, seed=0):
    """The particle filter's map of a drive by a feature that it is given."""
    rng = np.random.default_rng(seed)
    state = particle_slam.init("1", cfg, rng, feature="normalised", calibration=feature.calibration)
    infos = ScanInfos()
    for event in sim.log.events():
        state, info = particle_slam.step(state, event, cfg, rng)
        if info is not None:
            infos.append(info)
    return finish(sim.log, cfg, feature, particle_slam.trajectory(state), infos)


@pytest.mark.parametrize(("feature", "least", "most"), [("normalised", 0.85, 1.0), ("none", 0.0, 0.40)])
def test_in_a_flush_corridor_only_brightness_mends_a_start_that_is_off(feature, least, most):
    """64 particles spread 0.8 m along the wall round a start 0.4 m off: is the likeliest one where the robot is?"""
    sim = simulate_corridor(CorridorConfig(long_leg=40.0, distance=24.0, start=4.0), seed=33)
    cfg = replace(CFG, feature=feature)
    found = choose_feature(sim.log, cfg)
    truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
    seen = [beams(scan, found.name, found.calibration, cfg.beam) for scan in sim.log.scans]
    grid, row = ParticleGrid(1, cfg.cells), np.zeros(1, int)
    for k in range(0, len(seen), 2):
        grid.insert(row, truth[k][None], as_points(seen[k]), seen[k].w.astype(np.float32))
    rng = np.random.default_rng(0)
    right = []
    for k in range(11, len(seen) - 20, 2):
        along = 0.4 * rng.choice([-1, 1]) + rng.uniform(-0.8, 0.8, 64)
        tried = np.column_stack([along, rng.normal(0, 0.01, 64), rng.normal(0, 0.003, 64)])
        D = grid.score(np.zeros(64, int), se2.compose(truth[k], tried), as_points(seen[k]))
        best = int(np.argmax(log_likelihood(D, cfg, found.name)[0]))
        right.append(abs(along[best]) < 0.12)
    assert least <= np.mean(right) <= most, f"{np.mean(right):.2f} of {len(right)}"
