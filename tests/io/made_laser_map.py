"""A small laser map made by hand, for tests of what is written of it."""

import numpy as np

from mapweave.core import se2
from mapweave.core.findings import Finding
from mapweave.core.records import Track
from mapweave.laser.laser_map import GridMap, IntensityCalibration, LaserMap, ScanRecords


def made_laser_map(n=40, light=True):
    rng = np.random.default_rng(7)
    rows, cols = 30, 50
    hits, passes = np.zeros((rows, cols), int), np.zeros((rows, cols), int)
    passes[3:27, 3:47] = 20
    for wall in (np.s_[3, 3:47], np.s_[26, 3:47], np.s_[3:27, 3], np.s_[3:27, 46]):
        hits[wall], passes[wall] = 30, 2
    weight = np.where(hits > 0, 10.0, 0.0)
    y, x = np.mgrid[0:rows, 0:cols]
    mean = np.stack([-1.0 + 0.1 * (x + 0.5), -2.0 + 0.1 * (y + 0.5)], axis=-1) * (weight > 0)[..., None]
    q = np.where(hits > 0, 0.5 + 0.4 * np.sin(x / 3.0), 0.0) * light
    grid = GridMap(0.1, np.array([-1.0, -2.0]), hits, passes, mean, q, weight)
    t = 100.0 + 0.5 * np.arange(n)
    pose = np.column_stack([np.linspace(0, 3, n), -0.5 * np.ones(n), np.linspace(0, 0.3, n)])
    pose = se2.between(pose[0], pose)
    decision = ["first", *rng.choice(["matched", "odometry", "skipped"], n - 1, p=[0.8, 0.1, 0.1])]
    scans = ScanRecords(
        t,
        tuple("flirt" if k % 2 else "mrpt" for k in range(n)),
        pose,
        rng.normal(0, [0.02, 0.01, 0.005], (n, 3)),
        np.full(n, 170),
        rng.integers(120, 170, n),
        tuple(map(str, decision)),
        np.where(np.arange(n) % 3, rng.uniform(20, 100, n), np.nan),
        np.arange(n) % 10 == 9,
    )
    fine = np.unique(np.concatenate([t, t[:-1] + 0.25]))
    track = Track(fine, se2.interpolate(fine, t, pose), None, "local_1")
    drift = np.column_stack([0.02 * np.arange(len(fine)), 0.01 * np.arange(len(fine)), np.zeros(len(fine))])
    knots = np.arange(0.2, 5.0, 0.4)
    calibration = IntensityCalibration(
        knots, -np.log1p((knots / 1.5) ** 2), 0.9, 31000.0, 0.06, 12345, 0.03 + 0.01 * knots
    )
    return LaserMap(
        "1",
        "particle",
        "normalised" if light else "none",
        track,
        grid,
        scans,
        "poses",
        Track(fine, track.pose + drift, None, "odom"),
        calibration if light else None,
        100,
        "robot.mcap",
        "abc",
        {"scan doubled": 2},
        (Finding("saw-nothing", action="something to know"),),
        {"map": 1.5},
    )
