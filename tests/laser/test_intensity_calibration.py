"""Self-calibration of intensity, from the log and its odometry alone."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.findings import Finding
from mapweave.laser.beam import BeamConfig, beams, calibrate
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature
from mapweave.sim.laser import SECOND_LAW, DriveConfig, Reflectance
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor


def correlation(sim):
    scans = [beams(s, "raw", None, BeamConfig()) for s in sim.log.scans]
    poses = np.array([s.odometry for s in sim.log.scans])
    found = calibrate(scans, poses)
    made = [beams(s, "normalised", found, BeamConfig()) for s in sim.log.scans]
    q = np.concatenate([b.q for b in made])
    rho = np.concatenate([sim.reflectance[k][b.beam] for k, b in enumerate(made)])
    return found, float(np.corrcoef(q, rho)[0, 1])


@pytest.mark.parametrize("law", [Reflectance(), SECOND_LAW], ids=["one law", "another law"])
def test_the_feature_found_follows_the_true_reflectance(law):
    """Neither law is told to the estimator; the second has a specular term its model does not even have."""
    sim = simulate_corridor(CorridorConfig(distance=60.0, drive=DriveConfig(law=law)), seed=21)
    found, r = correlation(sim)
    assert r >= 0.90
    assert found.residual < 0.15
    assert found.exponent == pytest.approx(law.exponent, abs=0.2)
    assert (np.diff(found.log_gain[3:]) < 0.02).all()


def test_the_95th_percentile_of_the_feature_is_nine_tenths():
    sim = simulate_corridor(CorridorConfig(distance=20.0), seed=22)
    feature = choose_feature(sim.log, LaserConfig())
    q = np.concatenate([beams(s, "normalised", feature.calibration, BeamConfig()).q for s in sim.log.scans])
    assert abs(np.quantile(q, 0.95) - 0.9) < 0.05


def test_a_log_whose_intensity_says_nothing_is_used_without_it_and_says_so():
    sim = simulate_corridor(CorridorConfig(distance=20.0), seed=23)
    rng = np.random.default_rng(0)

    def with_light(make):
        return replace(sim.log, scans=tuple(replace(s, intensities=make(len(s.ranges))) for s in sim.log.scans))

    for make, said in (
        (lambda n: None, "the log has none"),
        (lambda n: np.full(n, 7.0), "equal"),
        (lambda n: np.exp(rng.normal(0, 2, n)), "does not follow"),
    ):
        feature = choose_feature(with_light(make), LaserConfig())
        assert feature.name == "none"
        assert [f.code for f in feature.findings] == ["light-unused"]
        assert said in feature.findings[0].text
    assert choose_feature(sim.log, LaserConfig(feature="none")).findings == ()
    why = Finding("light-unused", value="all intensities are 47")
    told = replace(with_light(lambda n: None), findings=(why,))  # by its reader, which left them out
    assert choose_feature(told, LaserConfig()).findings == ()


@pytest.mark.parametrize("law", [Reflectance(), Reflectance(falloff=2.6, exponent=0.6)], ids=["one law", "another law"])
def test_a_planted_law_is_found_as_well_as_is_said(law):
    """A straight corridor, where range and incidence say the same of a wall and hardly tell the law, and a longer drive
    round its corners: errors of one standard deviation in the mean, about.
    """
    gains, exponents, unsure = [], [], []
    for seed, distance in ((140, 30.0), (142, 80.0)):
        sim = simulate_corridor(CorridorConfig(distance=distance, drive=DriveConfig(law=law)), seed=seed)
        scans = [beams(s, "raw", None, BeamConfig()) for s in sim.log.scans]
        found = calibrate(scans, np.array([s.odometry for s in sim.log.scans]))
        r = np.concatenate([b.r for b in scans])
        seen = np.array([(np.abs(r - knot) < 0.2).sum() > 200 for knot in found.knots])
        true = np.log(law.from_white(found.knots[None, seen])[0] / law.from_white(np.ones((1, 1)))[0, 0])
        gains.append(np.square((found.log_gain[seen] - true) / found.gain_sd[seen]).mean())
        exponents.append(((found.exponent - law.exponent) / found.exponent_sd) ** 2)
        unsure.append(found.exponent_sd)
    assert 0.3 < np.sqrt(np.mean(gains)) < 2.0
    assert 0.3 < np.sqrt(np.mean(exponents)) < 2.0
    assert unsure[0] > 1.5 * unsure[1]
