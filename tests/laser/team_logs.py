"""Logs of teams: one drive through an office floor cut into robots that know nothing of each other."""

from dataclasses import replace

import numpy as np

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office


def dark(log):
    """The log without the light sent back: mapped by geometry alone."""
    return replace(log, scans=tuple(replace(scan, intensities=None) for scan in log.scans))


def cut(log, start, end, robot="1", clock=0.0):
    """Scans `start` to `end` as a log of its own: its odometry begins elsewhere, its clock `clock` [s] later."""
    scans = log.scans[start:end]
    first = scans[0].odometry
    elsewhere = se2.compose(np.array([5.0, -3.0, 1.0 + int(robot)]), se2.inverse(first))
    own = tuple(replace(scan, odometry=se2.compose(elsewhere, scan.odometry)) for scan in scans)
    rows = log.odometry
    keep = (rows.t >= log.scan_t[start]) & (rows.t <= log.scan_t[end - 1])
    odometry = Track(rows.t[keep] + clock, se2.compose(elsewhere, rows.pose[keep]), frame=rows.frame)
    return LaserLog(robot, f"part{robot}.mcap", log.scan_t[start:end] + clock, own, odometry)


def part_of(truth, log, clock=0.0):
    """The truth along a log cut from it, with the log's clock."""
    rows = np.searchsorted(truth.t, log.odometry.t - clock - 1e-6)
    return Track(truth.t[rows] + clock, truth.pose[rows], frame="world")


def office(seed=1, **how):
    """A drive through a small office, without light."""
    made = simulate_office(OfficeConfig(**{"rooms": 3, "visited": 4, **how}), seed)
    return dark(made.log), made.truth
