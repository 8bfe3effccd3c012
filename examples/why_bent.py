"""Why a map is bent: a scanner mounted turned, which nobody told, found by `doctor` and mended."""

from dataclasses import replace

import numpy as np

import mapweave

# A drive whose scanner is turned by 25 degrees on its robot, while the log says that it looks ahead.
turned = (0.0, 0.0, np.radians(25.0))
made = mapweave.OfficeConfig(rooms=2, visited=2)
world = replace(made, drive=replace(made.drive, sensor_pose=turned))
log = mapweave.simulate_laser(world=world, seed=1).log
scans = {
    "t": log.scan_t,
    "ranges": np.array([np.where(scan.hit, scan.ranges, np.inf) for scan in log.scans]),
    "angles": log.scans[0].angles(),
    "range_max": log.scans[0].range_max,
}
assert log.odometry is not None
x, y, theta = log.odometry.pose.T
odometry = {"t": log.odometry.t, "x": x, "y": y, "theta": theta}
bent = mapweave.map(scans=scans, odometry=odometry)
for line in mapweave.doctor(bent).lines():
    print(line)

# What it says to do: the scanner's place on the robot, as `--sensor-pose` gives it.
mended = mapweave.map(scans=scans, odometry=odometry, laser=mapweave.LaserOptions(sensor_pose=turned))
print("mended:", mapweave.doctor(mended).summary())
