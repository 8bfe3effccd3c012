"""Logs that are copies of one drive are found out by equal scans, or places at one time; two drives are not."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.records import Track
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


def test_a_drive_given_again_with_noise_is_told_by_its_places_and_one_at_another_pace_is_not(drives):
    maps = [map_laser(log, CFG, 0) for log in drives]
    graphs, (one, other) = [m.graph.stored() for m in maps], (m.track for m in maps)
    late = Track(other.t + 500.0, other.pose)  # by another clock
    for track in (other, late):
        graph = replace(graphs[1], t=graphs[1].t + track.t[0] - other.t[0])
        (told,) = copies_found([graphs[0], graph], [{"1": one, "2": track}])
        assert (told.code, told.robot, told.value["other"]) == ("logs-alike", "2", "robot1")
        assert told.value["same"] >= 0.9 * told.value["all"]
    slow = Track(other.t[0] + 1.2 * (other.t - other.t[0]), other.pose)
    assert copies_found(graphs, [{"1": one, "2": slow}]) == []
    assert copies_found(graphs, [{"1": one}, {"2": other}]) == []  # nobody knows how the two lie
