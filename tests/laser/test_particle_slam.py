"""The particle filter: its pieces against the paper, and the whole on a small world."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan
from mapweave.laser.config import PAPER_FILTER, PAPER_SIGMA2, FilterConfig
from mapweave.laser.particle_slam import effective, log_likelihood, move
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

SHORT = CorridorConfig(long_leg=12.0, short_leg=8.0, distance=14.0, start=3.0)


@pytest.fixture(scope="module")
def short_drive():
    return simulate_corridor(SHORT, seed=4)


@pytest.mark.eq("Hara07:7")
def test_particles_move_by_odometry_in_their_own_frames_plus_normal_noise():
    f = FilterConfig(sd_xy=0.1, sd_xy_per_m=0.2, sd_turn=0.05, sd_turn_per_m=0.0)
    poses = np.tile([1.0, 2.0, 0.5], (20000, 1))
    u = np.array([0.5, 0.0, 0.1])
    w = se2.between(se2.compose(poses, u), move(poses, u, f, np.random.default_rng(0)))
    # the noise is added to u before the particle's frame is left: seen from the noise-free pose it is turned by u
    w[:, :2] = w[:, :2] @ se2.rotation(0.1).T
    assert np.abs(w.mean(axis=0)).max() < 0.01
    assert np.allclose(w.std(axis=0), [0.2, 0.2, 0.05], rtol=0.03)


@pytest.mark.eq("Hara07:8", "Hara07:9")
def test_the_papers_likelihood_is_normal_in_the_mean_distance_of_the_matched_beams():
    cfg = LaserConfig(likelihood="paper")
    D = np.array([[0.01, 0.02, 0.04], [0.0, 0.0, 0.0]], np.float32)
    found, _ = log_likelihood(D, cfg, "none")
    d = np.array([0.015, 0.0])  # the third beam of the first particle found nothing
    assert np.allclose(found, -(d**2) / (2 * PAPER_SIGMA2**2), rtol=1e-5)


def test_losing_a_match_never_pays_when_beams_are_shared():
    cfg = LaserConfig()
    D = np.full((4, 10), 0.01, np.float32)
    D[0, :3] = 0.04  # this particle lost three matches that the others have
    found, beams = log_likelihood(D, cfg, "none")
    assert beams == 10
    assert found[0] < found[1]
    D[:, 9] = 0.04  # a beam that hardly anyone matches says nothing
    D[1, 9] = 0.0
    assert log_likelihood(D, cfg, "none")[1] == 9


def test_the_effective_number_is_all_for_equal_weights_and_one_for_a_single_one():
    assert effective(np.zeros(7))[1] == pytest.approx(7)
    assert effective(np.array([0.0, -900.0, -900.0]))[1] == pytest.approx(1)


def box_scan(pose, n=121, half=(3.0, 2.0)):
    """What a scanner at `pose` inside a box of 6 x 4 m sees."""
    angle = np.linspace(-2.0, 2.0, n)
    a = angle + pose[2] + 1e-9
    tx = (np.sign(np.cos(a)) * half[0] - pose[0]) / np.cos(a)
    ty = (np.sign(np.sin(a)) * half[1] - pose[1]) / np.sin(a)
    return Scan(np.minimum(tx, ty), np.ones(n, bool), None, -2.0, float(angle[1] - angle[0]), 30.0)


def small(**more):
    return LaserConfig(**({"method": "particle", "particles": 24, "threads": 1} | more))


@pytest.mark.eq("Hara07:4", "Hara07:6")
def test_the_answer_is_one_particles_trajectory_with_the_map_its_scans_lay_down(short_drive):
    made = map_laser(short_drive.log, small(), 0)
    assert np.array_equal(made.track.t, short_drive.log.stamps())
    assert np.abs(made.track.pose[0]).max() < 1e-9
    truth = se2.interpolate(made.track.t, short_drive.truth.t, short_drive.truth.pose)
    error = se2.between(se2.between(truth[0], truth), made.track.pose)
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.25
    assert made.feature == "normalised"
    assert set(made.scans.decision) <= {"first", "matched", "skipped"}
    assert np.nanmin(made.scans.n_eff) < 24
    cells = made.grid.cells()
    walls = np.array(short_drive.world.segments)
    ends = se2.act(se2.inverse(short_drive.truth.pose[0]), walls.reshape(-1, 2, 2))
    assert np.median(_distance(cells[:, :2], ends)) < 0.08


def _distance(points, segments):
    a, b = segments[:, 0], segments[:, 1]
    along = b - a
    s = np.clip(((points[:, None] - a) * along).sum(2) / (along**2).sum(1), 0, 1)
    return np.linalg.norm(points[:, None] - a - s[..., None] * along, axis=2).min(axis=1)


def test_the_same_seed_gives_the_same_map_whatever_the_number_of_threads(short_drive):
    one, two = (map_laser(short_drive.log, small(threads=n), 3) for n in (1, 2))
    assert np.array_equal(one.track.pose, two.track.pose)
    assert np.array_equal(one.grid.feature, two.grid.feature)
    assert np.array_equal(one.scans.n_eff, two.scans.n_eff, equal_nan=True)
    other = map_laser(short_drive.log, small(), 4)
    assert not np.array_equal(one.track.pose, other.track.pose)


def test_the_papers_filter_weighs_every_scan_and_may_resample_every_time(short_drive):
    made = map_laser(short_drive.log, small(filter=PAPER_FILTER, likelihood="paper", resample=1.0), 0)
    assert made.scans.resampled[1:].all()
    assert np.isfinite(made.scans.n_eff[1:]).all()


def test_a_log_without_odometry_is_mapped_by_scan_matching_alone():
    truth = np.column_stack([np.linspace(-1.5, 1.5, 31), np.zeros(31), np.linspace(0, 0.6, 31)])
    log = LaserLog("1", "box", np.arange(31.0), tuple(box_scan(pose) for pose in truth), None, "none")
    made = map_laser(log, small(), 0)
    assert made.odometry == "none"
    assert made.feature == "none"
    assert made.dead_reckoning is None
    assert np.array_equal(made.track.t, log.scan_t)
    assert np.abs(made.track.pose - se2.between(truth[0], truth)).max() < 0.08


def test_a_scan_without_returns_is_carried_over_by_odometry(short_drive):
    log = short_drive.log
    scans = list(log.scans)
    scans[10] = replace(scans[10], hit=np.zeros(len(scans[10].ranges), bool))
    made = map_laser(replace(log, scans=tuple(scans)), small(), 0)
    assert made.scans.decision[10] == "empty"
    full = map_laser(log, small(), 0)
    assert np.abs(made.track.pose[-1, :2] - full.track.pose[-1, :2]).max() < 0.3
