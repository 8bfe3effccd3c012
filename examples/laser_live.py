"""A laser map while the robot drives: every scan gives the pose and how sure it is."""

import tempfile
from collections.abc import Iterator

import numpy as np

import mapweave


# Your driver stands here: anything that yields a stamp, ranges, and where the wheels say the robot is. This one plays a
# simulated drive of twelve metres.
def driver() -> Iterator[tuple[float, np.ndarray, np.ndarray, np.ndarray | None]]:
    drive = mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=12.0), seed=1)
    for t, scan in zip(drive.log.scan_t, drive.log.scans, strict=True):
        yield t, np.where(scan.hit, scan.ranges, np.inf), scan.angles(), scan.odometry


slam = mapweave.LaserSlam()
for t, ranges, angles, wheels in driver():
    pose, cov = slam.add_scan(t, ranges, angles, odometry=wheels)
    if len(slam) % 12 == 0:
        x, y, theta = pose
        print(f"{t:.1f} s: ({x:.2f}, {y:.2f}) m, {np.degrees(theta):.0f} degrees, sd {np.sqrt(cov[0, 0]):.3f} m in x")

# The map so far, at any time: log odds in cells.
grid = slam.map()
print(f"{(grid.occupancy() > 0.65).sum()} cells are occupied")

# Keyframes, their returns and the loops found: what a program that shares the map sends to others.
graph = slam.graph()
print(f"{len(graph)} keyframes, {len(graph.points)} returns, {len(graph.accepted().first)} loops closed")

# The whole result, as `mapweave map` writes it: `mapweave localize`, `evaluate` and `view` take the folder.
with tempfile.TemporaryDirectory() as folder:
    print(slam.save(folder).summary())
