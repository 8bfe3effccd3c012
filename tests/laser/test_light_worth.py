"""Light gets the weight that it earns along the walls of its own log, and none where it tells nothing."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.io.laser_logs import read_laser
from mapweave.laser.beam import (
    CALIBRATION_WINDOW,
    MOST_RESIDUAL,
    NO_LIGHT,
    WHOLE,
    BeamConfig,
    IntensityCalibration,
    beams,
    calibrated,
)
from mapweave.laser.config import REFINE_BARE_TANGENT, Feature, weighed
from mapweave.laser.light_worth import BESIDE, worth
from mapweave.laser.scan_matching import BARE_TANGENT
from mapweave.mapping import laser_mapping
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature, contradicting, map_laser
from mapweave.sim.laser import LDS01, NEATO, SECOND_LAW, DriveConfig
from mapweave.sim.laser_worlds import (
    CorridorConfig,
    OfficeConfig,
    TunnelConfig,
    simulate_corridor,
    simulate_office,
    simulate_tunnel,
)

from .spoilt_light import (
    fixed_to_the_scanner,
    in_another_unit_from,
    of_another,
    shuffled_along_walls,
    stuck_from,
    with_light,
)

CFG = LaserConfig()
REAL = ("neato_first_bag.bag", "tb3_jchee_maze.bag", "tb3_khaidarovs_wall_cmdodom.clf.gz")


def corridor(seed, distance=20.0, **kw):
    return simulate_corridor(CorridorConfig(distance=distance, **kw), seed=seed).log


@pytest.fixture(scope="module")
def drive():
    return corridor(70)


@pytest.fixture(scope="module")
def tunnel():
    return simulate_tunnel(TunnelConfig(), seed=70).log


@pytest.mark.parametrize(
    "make",
    [
        lambda: corridor(71),
        lambda: corridor(72, drive=DriveConfig(law=SECOND_LAW)),
        lambda: simulate_office(OfficeConfig(), seed=71).log,
    ],
    ids=["corridor", "second law", "office"],
)
def test_light_that_belongs_to_walls_steers_with_its_weight_and_nothing_is_warned_of(make):
    feature = choose_feature(make(), CFG)
    assert (feature.name, feature.warnings) == ("normalised", ())
    assert feature.calibration.weight > 0.5


@pytest.mark.parametrize("seed", [80, 81, 82, *(pytest.param(k, marks=pytest.mark.slow) for k in range(83, 100))])
def test_light_shuffled_along_walls_of_any_world_gets_no_weight(seed, tunnel):
    log = corridor(seed, 12.0)
    spoilt = (shuffled_along_walls, fixed_to_the_scanner, lambda log: of_another(log, tunnel.scans))
    feature = choose_feature(spoilt[seed % 3](log), CFG)
    assert feature.name == "none"
    assert feature.calibration.residual > MOST_RESIDUAL or feature.calibration.weight == 0.0
    assert "is not used" in feature.warnings[0]


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_light_of_real_logs_gets_no_weight_shuffled_or_of_another_log(data, name):
    log = read_laser(data / "light" / name)
    others = read_laser(data / "light" / "tb3_starchon_wall.bag").scans
    for spoilt in (shuffled_along_walls(log), of_another(log, others)):
        feature = choose_feature(spoilt, CFG)
        assert feature.name == "none"
        assert "is not used" in feature.warnings[0]


@pytest.mark.data
def test_a_neato_along_a_bare_wall_is_mapped_as_its_wheels_tell(data):
    log = read_laser(data / "light" / "neato_first_bag.bag")
    made = map_laser(log, LaserConfig(method="graph"), 0)
    wheels = np.array([scan.odometry for scan in log.scans])
    wheels = se2.between(wheels[0], wheels)
    pose = se2.between(made.scans.pose[0], made.scans.pose)
    at = int(np.searchsorted(log.scan_t, log.scan_t[0] + 24.5))
    assert np.hypot(*(pose[at] - wheels[at])[:2]) < 0.7
    apart = se2.between(se2.between(wheels[:-1], wheels[1:]), se2.between(pose[:-1], pose[1:]))
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.1
    assert made.feature == "none"
    assert any("does not repeat better" in warning for warning in made.warnings)


def test_what_is_printed_as_the_feature_is_what_steered_without_wheels_too():
    log = simulate_office(OfficeConfig(), seed=72).log
    log = replace(log, odometry=None, scans=tuple(replace(scan, odometry=None) for scan in log.scans[:120]))
    log = replace(log, scan_t=log.scan_t[:120])
    feature = choose_feature(log, CFG)
    assert feature.name == "normalised"
    assert feature.calibration.weight > 0
    made, bare = (map_laser(log, LaserConfig(method="gated", feature=name), 0) for name in ("normalised", "none"))
    assert (made.feature, bare.feature) == ("normalised", "none")
    assert not np.array_equal(made.scans.pose, bare.scans.pose)


def test_information_is_the_excess_of_places_beside_over_the_square_of_their_distance(drive):
    returns = [beams(scan, "none", None, BeamConfig()) for scan in drive.scans]
    wheels = np.array([scan.odometry for scan in drive.scans])
    told = worth(returns, wheels, calibrated(returns, wheels).halves, CALIBRATION_WINDOW)
    assert told.excess == pytest.approx(told.beside**2 / told.repeat**2 - 1, rel=1e-9)
    assert told.information == pytest.approx(told.excess / BESIDE**2)
    assert told.pairs > 1000
    assert told.sd < told.excess / 3
    assert told.repeat < 0.06


def test_a_law_that_was_fitted_to_other_windows_foretells_light_of_a_saturated_scanner_as_well(drive):
    def saturated(_, scan):
        return np.where(scan.hit, np.minimum(scan.intensities, 12000.0), 0.0)

    feature = choose_feature(with_light(drive, saturated), CFG)
    assert feature.name == "normalised"
    assert len(feature.calibration.cosines)  # no form fits: the law is free


def test_settings_lie_between_those_without_light_and_those_with_it_as_its_weight_says():
    def of(information):
        calibration = IntensityCalibration(
            np.array([0.0, 1.0]), np.zeros(2), 1.0, 1.0, 0.1, 9, np.zeros(2), information=information
        )
        return weighed(CFG, Feature("normalised", calibration))

    assert of(WHOLE) == of(3 * WHOLE) == CFG
    half = of(WHOLE / 2)
    front, f = CFG.front_end, CFG.filter
    assert half.front_end.alpha == front.alpha / 2
    assert half.front_end.tangent == pytest.approx((BARE_TANGENT + front.tangent) / 2)
    assert half.cells.alpha == CFG.cells.alpha / 2
    assert half.icp.alpha == CFG.icp.alpha / 2
    assert half.filter.neff == (f.bare_neff + f.neff) / 2
    assert half.filter.refine_tangent == pytest.approx((REFINE_BARE_TANGENT + f.refine_tangent) / 2)
    none = of(0.0)
    assert (none.front_end.alpha, none.front_end.tangent) == (0.0, BARE_TANGENT)
    assert (none.cells.alpha, none.filter.neff) == (0.0, f.bare_neff)
    assert weighed(CFG, Feature("none", None)) == CFG


def test_motion_with_light_that_wheels_contradict_is_given_up_for_geometry_and_told(drive, monkeypatch):
    """Light that runs along with the robot, forced upon it with full weight: it would have the robot stand."""
    spoilt = fixed_to_the_scanner(drive)
    calibration = replace(choose_feature(spoilt, CFG).calibration, information=WHOLE)
    strong = replace(CFG, front_end=replace(CFG.front_end, tangent=2.0, neff=600.0, sd_xy_per_m=3.0), particles=5)
    monkeypatch.setattr(laser_mapping, "choose_feature", lambda *_: Feature("normalised", calibration))
    made = map_laser(spoilt, strong, 0)
    monkeypatch.undo()
    assert made.feature == "none"
    assert any("contradicts the wheels" in warning for warning in made.warnings)
    assert contradicting(made.scans.pose, drive) < 0.05


def test_steps_that_contradict_wheels_are_counted_by_three_standard_deviations(drive):
    wheels = np.array([scan.odometry for scan in drive.scans])
    assert contradicting(wheels, drive) == 0.0
    step = float(np.median(np.hypot(*np.diff(wheels[:, :2], axis=0).T)))
    for factor, expected in ((2.9, 0), (3.1, 1)):
        moved = np.array(wheels)
        moved[40:] = se2.compose(
            se2.compose(wheels[40], np.array([factor * (0.01 + 0.1 * step), 0.0, 0.0])),
            se2.between(wheels[40], wheels[40:]),
        )
        assert round(contradicting(moved, drive) * (len(wheels) - 1)) == expected
    bare = replace(drive, scans=tuple(replace(scan, odometry=None) for scan in drive.scans))
    assert contradicting(wheels, bare) == 0.0


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_light_that_changes_its_unit_in_the_middle_is_told_and_left_out(drive, factor):
    feature = choose_feature(in_another_unit_from(drive, 40, factor), CFG)
    assert feature.name == "none"
    assert "changes its unit in the middle" in feature.warnings[0]


def test_light_that_sticks_from_the_middle_on_is_left_out(drive):
    assert choose_feature(stuck_from(drive, 40), CFG).name == "none"


def test_light_that_one_side_never_gives_is_told_and_left_out(drive):
    def one_sided(_, scan):
        return np.where(np.arange(len(scan.ranges)) < len(scan.ranges) / 2, 0.0, scan.intensities)

    feature = choose_feature(with_light(drive, one_sided), CFG)
    assert feature.name == "none"
    assert "bear no light" in feature.warnings[0]


@pytest.mark.parametrize("bad", [np.nan, -5.0, 0.0, np.inf, NO_LIGHT])
def test_single_returns_without_light_keep_their_geometry_and_the_log_its_feature(drive, bad):
    rng = np.random.default_rng(0)

    def some(_, scan):
        return np.where(rng.random(len(scan.ranges)) < 0.05, bad, scan.intensities)

    spoilt = with_light(drive, some)
    feature = choose_feature(spoilt, CFG)
    assert feature.name == "normalised"
    whole = choose_feature(drive, CFG).calibration
    assert feature.calibration.scale == pytest.approx(whole.scale, rel=0.05)
    for scan in spoilt.scans[:10]:
        lit, bare = (beams(scan, name, feature.calibration, CFG.beam) for name in ("normalised", "none"))
        assert np.array_equal(lit.beam, bare.beam)
        assert np.isfinite(lit.q).all()
        unmeasured = ~np.isfinite(scan.intensities) | (scan.intensities <= 0) | (scan.intensities == NO_LIGHT)
        assert (lit.q[unmeasured[lit.beam]] == feature.calibration.middle).all()


def rplidar(i):
    """Quality: whole numbers up to 63, strong light cut off."""
    return np.clip(np.round(i / 350.0), 1, 63)


HEADS = {
    "LDS-01": (LDS01, None, True),
    "Neato": (NEATO, None, None),  # its beams' own gains may hide what posters tell: either, and never in silence
    "RPLIDAR quality": (None, rplidar, True),
    "URG and UTM": (None, lambda i: np.round(i / 10.0), True),
    "SICK RSSI, 8 bits": (None, lambda i: np.clip(np.round(25.0 * np.log(np.maximum(i, 1.0))), 1, 254), True),
    "constant": (None, lambda i: np.full_like(i, 47.0), False),
    "as strong as its return is near": (None, None, False),
}


@pytest.mark.parametrize("head", HEADS)
def test_known_scanners_steer_by_their_light_where_it_belongs_to_walls_and_else_say_why_not(head):
    law, said, steers = HEADS[head]
    log = corridor(73, 15.0, **({} if law is None else {"drive": DriveConfig(law=law)}))
    if said is not None:
        log = with_light(log, lambda _, scan: np.where(scan.hit, said(np.array(scan.intensities)), 0.0))
    if head == "as strong as its return is near":
        log = with_light(log, lambda _, scan: np.where(scan.hit, np.round(1000.0 / (1.0 + scan.ranges)), 0.0))
    feature = choose_feature(log, CFG)
    assert (feature.name == "normalised") == (not feature.warnings)
    if steers is not None:
        assert (feature.name == "normalised") == steers
