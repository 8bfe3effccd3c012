"""Logs that are copies of one drive are found out by scans that are equal to the last digit; two drives are not."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.laser.log_warnings import copies_found
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

CFG = LaserConfig(method="graph", feature="none")


@pytest.fixture(scope="module")
def drives():
    """Two drives by the same way through one office, the noise of scanner and wheels apart."""
    log = simulate_office(OfficeConfig(rooms=2, visited=1), 1).log
    rng = np.random.default_rng(2)
    noisy = tuple(replace(s, ranges=s.ranges + 0.005 * rng.standard_normal(len(s.ranges))) for s in log.scans)
    return log, replace(log, robot="2", scans=noisy)


def test_a_drive_given_again_with_other_stamps_or_half_its_scans_is_told(drives):
    first, _ = drives
    late = replace(first, robot="2", scan_t=first.scan_t + 500.0, odometry=None)
    some = replace(first, robot="3", scan_t=first.scan_t[::2], scans=first.scans[::2])
    graphs = [map_laser(log, CFG, 0).graph.stored() for log in (first, late, some)]
    told = copies_found(graphs)
    assert [(f.robot, f.value["other"]) for f in told] == [("2", "robot1"), ("3", "robot1"), ("3", "robot2")]
    assert {f.code for f in told} == {"logs-alike"}
    assert told[0].value["same"] == told[0].value["all"] == len(graphs[0])


def test_two_drives_by_one_way_are_no_copies(drives):
    assert copies_found([map_laser(log, CFG, 0).graph.stored() for log in drives]) == []
