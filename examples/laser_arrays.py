"""A laser map from arrays in memory: ranges, angles, intensities, and poses from odometry."""

import numpy as np

import mapweave

# Any source of arrays will do; here a simulated drive of twelve metres stands for a robot of one's own.
drive = mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=12.0), seed=1)
log = drive.log

scans = {
    "t": log.scan_t,  # (m,) [s]
    "ranges": np.array([np.where(scan.hit, scan.ranges, np.inf) for scan in log.scans]),  # (m, n) [m]
    "angles": log.scans[0].angles(),  # (n,) [rad], counter-clockwise from ahead
    "intensities": np.array([scan.intensities for scan in log.scans]),  # (m, n), optional
    "range_max": log.scans[0].range_max,  # [m], optional
}
assert log.odometry is not None  # a simulated robot has wheels
poses = log.odometry.pose
odometry = {"t": log.odometry.t, "x": poses[:, 0], "y": poses[:, 1], "theta": poses[:, 2]}

result = mapweave.map(scans=scans, odometry=odometry, method="gated")
print(result.summary())

# The map: log odds in cells, and the robot's pose at every stamp in the frame of its first pose.
made = result.maps[0]
occupied = made.grid.occupancy() > 0.65
print(f"{occupied.sum()} of {occupied.size} cells are occupied")
print(f"the drive ends at {np.round(made.track.pose[-1], 2).tolist()} [m, m, rad]")
