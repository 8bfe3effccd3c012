"""What intensity is worth on the 200 m ring, statement by statement, over six drives."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.laser.refine import systematic
from mapweave.laser import particle_slam
from mapweave.laser.beam import beams
from mapweave.laser.particle_grid import ParticleGrid
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature, map_laser
from mapweave.papers.hara.experiments import (
    GRAPH,
    ICP,
    PRINTED,
    WHEELS_KNOWN,
    WHEELS_PROPOSE,
    geometry_bound,
    on_rims,
    score,
)
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

from ..laser.test_corridor_statements import LAW, mapped_by

SEEDS = range(6)
FULL = LaserConfig(method="particle", particles=512)
METHODS = {
    "icp geometry": replace(ICP, feature="none"),
    "icp": ICP,
    "geometry": replace(FULL, feature="none", filter=WHEELS_PROPOSE),
    "geometry, default": replace(FULL, feature="none"),
    "printed": replace(PRINTED, particles=512),
    "512": FULL,
    "128": LaserConfig(method="particle", particles=128),
    "graph": GRAPH,
    "graph, geometry": WHEELS_KNOWN,
}


@pytest.fixture(scope="module")
def drives():
    return [simulate_corridor(seed=seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def errors(drives):
    """ATE [m] by method, one a seed, each worked out when it is first asked for."""
    known = {}

    def of(name):
        if name not in known:
            if name == "odometry":
                known[name] = np.array([score(_driven(sim.log), sim.truth) for sim in drives])
            else:
                made = [map_laser(sim.log, METHODS[name], seed) for seed, sim in enumerate(drives)]
                known[name] = np.array([score(m.track, sim.truth) for m, sim in zip(made, drives, strict=True)])
        return known[name]

    return of


def _driven(log):
    return map_laser(replace(log, scan_t=log.scan_t[:2], scans=log.scans[:2]), ICP, 0).dead_reckoning


@pytest.mark.long
def test_our_filter_with_intensity_errs_a_fraction_of_geometry_and_of_odometry(errors):
    ours = errors("512")
    assert ours.mean() <= 0.40 * min(errors("geometry").mean(), errors("geometry, default").mean())
    assert ours.mean() <= 0.05 * errors("odometry").mean()
    assert ours.max() <= 0.30
    assert (ours <= 0.9 * errors("icp")).all()


@pytest.mark.long
def test_the_printed_filter_does_not_close_the_loop_where_matching_alone_does_not(errors):
    """Measured: 0.58 m against 0.46 m; less than matching alone in two of six drives."""
    printed, icp = errors("printed"), errors("icp")
    assert np.mean(printed <= 0.9 * icp) < 0.5
    assert printed.mean() > 0.9 * icp.mean()
    assert (printed <= 0.25 * errors("odometry")).all()


@pytest.mark.long
def test_intensity_errs_a_seventh_of_the_best_geometry_and_of_the_least_that_geometry_can(drives, errors):
    """The rims of light move a graph of 12 cm to 5; nobody can err less than 0.44 m without light."""
    rims = np.array(
        [score(on_rims(sim.log, map_laser(sim.log, GRAPH, seed)), sim.truth) for seed, sim in enumerate(drives)]
    )
    best = min(errors(name).mean() for name in ("geometry", "geometry, default", "graph, geometry"))
    assert rims.mean() <= 0.15 * best
    assert rims.mean() <= 0.15 * geometry_bound(drives[0], CorridorConfig())


@pytest.mark.long
def test_intensity_icp_errs_half_of_odometry_at_most_and_less_than_icp_on_geometry(errors):
    assert (errors("icp") <= 0.5 * errors("odometry")).all()
    assert errors("icp").mean() <= 0.75 * errors("icp geometry").mean()


@pytest.mark.long
def test_a_quarter_of_the_particles_errs_at_most_twice_as_much(errors):
    assert errors("128").mean() <= 2.0 * errors("512").mean()


@pytest.mark.long
def test_the_feature_found_from_the_log_is_the_reflectance_and_maps_as_well_as_the_true_law(drives, errors):
    told = []
    for seed, sim in enumerate(drives):
        feature = choose_feature(sim.log, LaserConfig())
        seen = [beams(s, "normalised", feature.calibration, LaserConfig().beam) for s in sim.log.scans]
        q = np.concatenate([b.q for b in seen])
        rho = np.concatenate([sim.reflectance[k][b.beam] for k, b in enumerate(seen)])
        assert np.corrcoef(q, rho)[0, 1] >= 0.90
        told.append(score(mapped_by(sim, replace(feature, calibration=LAW), METHODS["128"], seed).track, sim.truth))
    assert errors("128").mean() <= 1.5 * np.mean(told)


@pytest.mark.long
def test_a_pose_graph_behind_the_filter_closes_five_of_six_loops_and_no_closure_is_wrong(drives):
    closed = 0
    for seed, sim in enumerate(drives):
        made = map_laser(sim.log, METHODS["graph"], seed)
        closed += score(made.track, sim.truth) <= 0.30
        graph = made.graph
        truth = se2.interpolate(graph.t, sim.truth.t, sim.truth.pose)
        for c in graph.closures:
            off = se2.between(c.measured, se2.between(truth[c.first], truth[c.second]))
            assert np.hypot(off[0], off[1]) <= 0.5 or not c.accepted
    assert closed >= 5


@pytest.mark.slow
@pytest.mark.parametrize(("feature", "least", "most"), [("normalised", 0.85, 1.0), ("none", 0.0, 0.40)])
def test_a_start_that_is_off_along_a_flush_wall_is_mended_by_tracking_with_brightness_alone(feature, least, most):
    """64 particles round a start 0.4 m off along the wall follow the robot for 5 m: is their mean where it is?"""
    rng = np.random.default_rng(0)
    right = []
    for seed in (30, 31, 32):
        sim = simulate_corridor(CorridorConfig(long_leg=50.0, distance=32.0, start=6.0), seed=seed)
        cfg = LaserConfig(feature=feature)
        light = choose_feature(sim.log, cfg)
        truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
        seen = [beams(s, light.name, light.calibration, cfg.beam) for s in sim.log.scans]
        grid, row = ParticleGrid(1, cfg.cells), np.zeros(1, int)
        for k in range(0, len(seen), 2):
            grid.insert(row, truth[k][None], particle_slam.as_points(seen[k]), seen[k].w.astype(np.float32))
        for start in range(15, len(seen) - 36, 10):
            off = np.column_stack([rng.normal(0.4 * rng.choice([-1, 1]), 0.25, 64), rng.normal(0, [[0.02, 0.01]] * 64)])
            poses, log_weight = se2.compose(truth[start], off), np.zeros(64)
            for k in range(start + 1, start + 21):
                u = se2.between(sim.log.scans[k - 1].odometry, sim.log.scans[k].odometry)
                poses = particle_slam.move(poses, u, WHEELS_PROPOSE, rng)
                D = grid.score(np.zeros(64, int), poses, particle_slam.as_points(seen[k]))
                log_weight = log_weight + particle_slam.log_likelihood(D, cfg, light.name)[0]
                w, n_eff = particle_slam.effective(log_weight)
                if n_eff < 32:
                    poses, log_weight = poses[systematic(w, float(rng.random()))], np.zeros(64)
            mean = np.average(poses[:, :2], axis=0, weights=np.exp(log_weight - log_weight.max()))
            right.append(np.hypot(*(mean - truth[start + 20, :2])) < 0.15)
    assert least <= np.mean(right) <= most, f"{np.mean(right):.2f} of {len(right)}"
