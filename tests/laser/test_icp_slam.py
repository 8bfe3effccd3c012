"""One hypothesis: what the gate is for."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import ConfigError
from mapweave.laser.scan_matching import FrontEndConfig
from mapweave.laser.scan_odometry import inside
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

GOOD_WHEELS = FrontEndConfig(sd_xy=0.01, sd_xy_per_m=0.06, sd_turn=0.01, sd_turn_per_m=0.02, sd_turn_per_rad=0.05)


@pytest.mark.eq("Hara07:5")
def test_the_gate_is_an_interval_in_each_of_x_y_and_theta():
    eps = np.array([0.1, 0.1, 0.05])
    assert inside(np.array([0.1, -0.1, 0.05]), eps)
    for k in range(3):
        off = np.zeros(3)
        off[k] = -1.01 * eps[k]
        assert not inside(off, eps)


@pytest.fixture(scope="module")
def with_failures():
    """A drive on which every tenth scan is another place's: matching it leads astray."""
    sim = simulate_corridor(CorridorConfig(long_leg=12.0, short_leg=8.0, distance=16.0, start=3.0), seed=2)
    scans = list(sim.log.scans)
    bad = range(12, len(scans), 10)
    for k in bad:
        scans[k] = replace(
            scans[k], ranges=np.array(scans[k].ranges) + 0.25, intensities=np.array(scans[k - 6].intensities)
        )
        scans[k] = replace(scans[k], angle_min=scans[k].angle_min + 0.25)
    return sim, replace(sim.log, scans=tuple(scans)), list(bad)


@pytest.mark.parametrize("matcher", ["icp", "map"])
def test_injected_match_failures_are_refused_by_the_gate_and_the_map_survives(with_failures, matcher):
    sim, log, bad = with_failures
    cfg = LaserConfig(threads=1, matcher=matcher, front_end=GOOD_WHEELS, gate_sd_xy=0.0, gate_sd_turn=0.01)
    truth = se2.interpolate(log.scan_t, sim.truth.t, sim.truth.pose)
    truth = se2.between(truth[0], truth)

    def heading_error(made):
        return float(np.abs(se2.wrap_angle(made.scans.pose[:, 2] - truth[:, 2])).max())

    gated = map_laser(log, replace(cfg, method="gated"), 0)
    free = map_laser(log, replace(cfg, method="gated", gate=1e9), 0)
    refused = [k for k, d in enumerate(gated.scans.decision) if d == "odometry"]
    assert len(set(refused) & set(bad)) >= 0.8 * len(bad)
    assert len(set(refused) - set(bad)) <= 0.2 * len(log.scans)
    assert heading_error(gated) < 0.12
    assert heading_error(free) > 2 * heading_error(gated)


def test_words_that_are_not_known_are_refused():
    for wrong in ({"method": "ekf"}, {"feature": "colour"}, {"particles": 0}, {"resample": 2.0}, {"likelihood": "x"}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            LaserConfig(**wrong).check()
