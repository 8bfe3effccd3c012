"""The ring corridor: what the specification says of it holds, and equal seeds give equal logs."""

from pathlib import Path

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.se2 import heading_of_quaternion, quaternion_of_heading, representable_heading
from mapweave.sim.laser import (
    FITTED,
    LAWS,
    LDS01,
    NEATO,
    SECOND_LAW,
    DriftConfig,
    DriveConfig,
    Scanner,
    drifted,
    measure,
    ring,
    through,
)
from mapweave.sim.laser_worlds import CorridorConfig, corridor_world, simulate_corridor


@pytest.fixture(scope="module")
def full():
    return simulate_corridor(seed=3)


SHORT = CorridorConfig(distance=6.0, drive=DriveConfig(drift=DriftConfig(end_error=None)))


def test_the_drive_is_200_m_with_a_scan_every_quarter_metre_and_about_22_m_of_overlap(full):
    steps = np.diff(full.truth.pose[:, :2], axis=0)
    assert abs(np.hypot(*steps.T).sum() - 200) < 0.2
    assert len(full.log.scans) == 801
    last = full.truth.pose[-1]
    assert abs(last[0] - 22) < 0.1
    assert abs(last[1]) < 1e-6


def test_odometry_ends_15_to_20_m_off(full):
    end = se2.between(full.truth.pose[0], full.truth.pose[-1])[:2]
    assert 15 <= np.hypot(*(full.log.odometry.pose[-1, :2] - end)) <= 20


def test_beams_reach_the_walls_and_the_scanner_rounds_to_a_millimetre(full):
    scan, pose = full.log.scans[0], full.truth.pose[0]
    assert len(scan.ranges) == 342
    assert np.degrees(scan.angles()[[0, -1]]) == pytest.approx([-120, 120])
    a, r = scan.angles()[scan.hit], scan.ranges[scan.hit]
    y = se2.act(pose, np.column_stack([r * np.cos(a), r * np.sin(a)]))[:, 1]
    assert np.abs(np.abs(y) - 1.25).max() < 0.25
    assert np.allclose(r * 1000, np.round(r * 1000), atol=2e-4)


def test_light_follows_the_law_the_specification_gives(full):
    scans = [(s, rho) for s, rho in zip(full.log.scans, full.reflectance, strict=True)][::40]
    r = np.concatenate([s.ranges[s.hit] for s, _ in scans])
    light = np.concatenate([s.intensities[s.hit] for s, _ in scans])
    rho = np.concatenate([x[s.hit] for s, x in scans])
    straight = light / (40000 * rho / (1 + (r / 1.5) ** 2))
    assert straight.max() < 1.25
    assert 0.9 < np.quantile(straight, 0.98) < 1.1


def test_doors_are_recessed_on_the_short_legs_alone():
    cfg = CorridorConfig()
    S = corridor_world(cfg, 0).segments
    long_y = S[np.abs(S[:, 1] - S[:, 3]) < 1e-9][:, 1]
    lines = [-1.25, 1.25, 28.75, 31.25]
    across_short = np.abs(S[:, 0] - S[:, 2]) < 1e-9
    recessed = [x for x in S[across_short][:, 0] if min(abs(x - v) for v in (-16.25, -13.75, 43.75, 46.25)) > 0.1]
    assert len(recessed) > 4
    assert all(abs(min(abs(x - v) for v in (-16.25, -13.75, 43.75, 46.25)) - 0.12) < 1e-9 for x in recessed)
    jambs = [y for y in long_y if min(abs(y - v) for v in lines) > 1e-9]
    assert len(jambs) == 2 * len(recessed)


def test_reflectances_are_paint_posters_and_doors():
    rho = corridor_world(CorridorConfig(), 1).reflectance
    paint = rho[(rho > 0.5) & (rho < 0.7)]
    assert abs(paint.mean() - 0.6) < 0.01
    assert abs(paint.std() - 0.018) < 0.004
    assert rho.min() > 0.05
    assert rho.max() < 0.95


def test_the_same_seed_gives_the_same_log_and_another_a_different_one():
    a, b, c = (simulate_corridor(SHORT, seed) for seed in (5, 5, 6))
    assert all(np.array_equal(x.ranges, y.ranges) for x, y in zip(a.log.scans, b.log.scans, strict=True))
    assert np.array_equal(a.log.odometry.pose, b.log.odometry.pose)
    assert not np.array_equal(a.log.scans[0].ranges, c.log.scans[0].ranges)


def test_another_reflectance_law_changes_the_light_and_nothing_else():
    a = simulate_corridor(SHORT, 2)
    other = CorridorConfig(distance=6.0, drive=DriveConfig(drift=DriftConfig(end_error=None), law=SECOND_LAW))
    b = simulate_corridor(other, 2)
    assert np.array_equal(a.log.odometry.pose, b.log.odometry.pose)
    assert np.array_equal(a.log.scans[3].ranges, b.log.scans[3].ranges)
    assert not np.array_equal(a.log.scans[3].intensities, b.log.scans[3].intensities)
    assert np.array_equal(a.reflectance, b.reflectance)


@pytest.mark.parametrize("law", [LDS01, NEATO], ids=["lds01", "neato"])
def test_a_fitted_law_returns_what_it_says_at_its_ranges_in_whole_numbers_and_weak_light_not_at_all(law):
    m, r = 4000, np.array(FITTED)
    shape = (m, len(r))
    scanner = Scanner(beams=len(r), far=9.0)
    rng = np.random.default_rng(3)
    said = [
        measure(np.tile(r, (m, 1)), np.zeros(shape, int), np.full(shape, c), np.full(shape, rho), scanner, law, rng)
        for c, rho in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.002))
    ]
    white, grazed, black = (np.where(ranges < scanner.range_max, light, np.nan) for ranges, light in said)
    sd = max(law.relative_noise, law.beams)
    expected = np.minimum(law.light, law.most)
    assert np.abs(np.log(np.nanmedian(white, axis=0) / expected)).max() < 4 * sd
    keeps = np.array(law.light) * 0.5**law.exponent > 3 * law.least  # and the greatest light is not cut off
    whole = keeps & (np.array(law.light) < law.most / np.exp(3 * sd))
    fell = np.nanmedian(grazed[:, whole], axis=0) / np.nanmedian(white[:, whole], axis=0)
    assert np.abs(np.log(fell) - law.exponent * np.log(0.5)).max() < 5 * sd
    assert np.nanmax(white) <= law.most
    assert (white == np.round(white))[np.isfinite(white)].all()
    assert np.isnan(black).mean() > 0.8


def test_beams_of_a_fitted_law_keep_a_gain_of_their_own_that_neighbours_share():
    shape = (50, 360)
    scanner, rng = Scanner(beams=360, opening=2 * np.pi), np.random.default_rng(1)
    still = (np.full(shape, 0.5), np.zeros(shape, int), np.ones(shape), np.full(shape, 0.8))
    _, light = measure(*still, scanner, NEATO, rng)
    assert np.ptp(light, axis=0).max() == 0  # from scan to scan
    own = np.log(light[0])
    assert 0.1 < own.std() < 0.3
    near, far = (np.corrcoef(own[:-k], own[k:])[0, 1] for k in (1, 20))
    assert near > 0.8
    assert abs(far) < 0.5


@pytest.mark.data
@pytest.mark.slow
def test_laws_of_real_scanners_are_what_their_logs_say(data, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import light_laws

    for name, files in light_laws.LOGS.items():
        found, law = light_laws.of_all([light_laws.fit(data / "light" / file) for file in files]), LAWS[name]
        assert np.abs(np.log(found.light / np.array(law.light))).max() < 0.05
        assert found.exponent == pytest.approx(law.exponent, abs=0.01)
        assert found[2:4] == pytest.approx((law.relative_noise, law.beams), abs=0.002)
        assert found[4:] == (law.least, law.most)


def test_people_stand_before_the_walls():
    walked = CorridorConfig(distance=6.0, drive=DriveConfig(drift=DriftConfig(end_error=None), people=60))
    a, b = simulate_corridor(SHORT, 2), simulate_corridor(walked, 2)
    nearer = [np.mean(y.ranges < x.ranges - 0.2) for x, y in zip(a.log.scans, b.log.scans, strict=True)]
    assert np.mean(nearer) > 0.05


def test_odometry_without_noise_or_bias_is_the_truth():
    truth = ring(10, 6, 1.0, 20.0, 3.0).poses(np.linspace(0, 20, 400))
    quiet = DriftConfig(scale=0, translation=0, rotation=0, end_error=None)
    poses, bias = drifted(truth, quiet, np.random.default_rng(0))
    assert np.allclose(poses, se2.between(truth[0], truth), atol=1e-9)
    assert bias == 0


def test_a_route_through_points_rounds_its_corners_and_ends_at_the_last():
    route = through([(0, 0), (4, 0), (4, 3)], 1.0)
    poses = route.poses(np.linspace(0, route.total, 200))
    assert np.allclose(poses[-1], [4, 3, np.pi / 2])
    assert abs(route.total - (3 + 2 + np.pi / 2)) < 1e-9
    assert np.hypot(poses[:, 0] - 4, poses[:, 1]).min() > 0.4


def test_a_representable_heading_comes_back_from_its_quaternion_to_the_bit():
    for theta in np.random.default_rng(1).uniform(-np.pi, np.pi, 3000):
        r = representable_heading(float(theta))
        assert heading_of_quaternion(*quaternion_of_heading(r)) == r
        assert abs(r - theta) < 1e-12
