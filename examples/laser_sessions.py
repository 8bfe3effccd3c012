"""Two drives through one office, days apart: the second goes on from the map of the first, its start unknown."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import mapweave

# One simulated drive stands for two days: every other scan of its first part, and those between of its last part, whose
# odometry begins anew at zero.
log = mapweave.simulate_laser(world=mapweave.OfficeConfig(rooms=3, visited=4), seed=3).log


def tables(some: slice) -> tuple[dict[str, Any], dict[str, Any]]:
    """The scans of a slice, and their odometry, as arrays."""
    own = [scan.odometry for scan in log.scans[some]]
    x, y, theta = np.array(own).T
    x, y, c, s = x - x[0], y - y[0], np.cos(theta[0]), np.sin(theta[0])
    t = log.scan_t[some]
    ranges = np.array([np.where(scan.hit, scan.ranges, np.inf) for scan in log.scans[some]])
    scans = {"t": t, "ranges": ranges, "angles": log.scans[0].angles(), "range_max": log.scans[0].range_max}
    return scans, {"t": t, "x": c * x + s * y, "y": c * y - s * x, "theta": theta - theta[0]}


n = len(log.scans)
(monday, wheels), (tuesday, more_wheels) = tables(slice(0, 5 * n // 8, 2)), tables(slice(3 * n // 8 | 1, n, 2))

with TemporaryDirectory() as folder:
    first = Path(folder) / "monday"
    mapweave.map(scans=monday, odometry=wheels, out=first, method="graph")
    both = mapweave.map(scans=tuesday, odometry=more_wheels, laser=mapweave.LaserOptions(resume=first))

print(both.summary())
assert isinstance(both, mapweave.LaserResult)
for merge in both.merges:
    print(f"robot {merge.a} and robot {merge.b}: {merge.reason}")
for made in both.components:
    accepted = sum(closure.accepted for closure in made.closures)
    print(f"{len(made.robots)} robots in one map, {accepted} of {len(made.closures)} closures believed")
