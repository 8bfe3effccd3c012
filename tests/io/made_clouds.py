"""A scanner of many rings, as seen from the plane scans of a simulated drive: walls upright, floor and ceiling flat."""

import numpy as np

from .ros_logs import Recording

RINGS = np.deg2rad(np.arange(-15.0, 16.0, 2.0))
ABOVE_FLOOR, CEILING = 0.6, 2.4  # [m] the scanner, and over the floor


def rings_of(scan, rng, *, lean=0.0, noise=0.01):
    """(n, 4) points x, y, z [m] and intensity that the scanner sees where `scan` was made, leaning ahead by `lean`."""
    r, a = np.broadcast_arrays(np.where(scan.hit, scan.ranges, 60.0), scan.angles())
    slope = np.tan(RINGS)[:, None]
    far = np.where(
        slope < 0, -ABOVE_FLOOR / slope, (CEILING - ABOVE_FLOOR) / slope
    )  # where a ring meets floor or ceiling
    flat = np.minimum(np.broadcast_to(r, (len(RINGS), len(r))), far) + noise * rng.normal(size=(len(RINGS), len(r)))
    seen = (flat < 55.0).ravel()
    x, y, z = (flat * np.cos(a)).ravel(), (flat * np.sin(a)).ravel(), (flat * slope).ravel()
    c, s = np.cos(lean), np.sin(lean)
    return np.column_stack([c * x - s * z, y, s * x + c * z, np.full(len(x), 10.0)])[seen]


def cloud_bag(path, log, *, lean=0.0, noise=0.01, every=1, seed=0):
    """The drive of `log` as it would be with this scanner, which transforms say stands level; lean None: as it was."""
    out, rng = Recording(path), np.random.default_rng(seed)
    x, y, yaw = log.scans[0].T_robot_sensor
    out.tf(log.scan_t[0] - 0.1, "base_link", "lidar", x=x, y=y, yaw=yaw, z=ABOVE_FLOOR, topic="/tf_static")
    for t, pose in zip(log.odometry.t, log.odometry.pose, strict=True):
        out.odom(t, pose[0], yaw=pose[2], y=pose[1])
    for t, scan in list(zip(log.scan_t, log.scans, strict=True))[::every]:
        if lean is None:
            r = np.where(scan.hit, scan.ranges + noise * rng.normal(size=len(scan.ranges)), np.inf)
            out.scan(t, r, angles=scan.angles()[[0, -1]], frame="lidar", far=55.0)
            continue
        out.cloud(t, rings_of(scan, rng, lean=lean, noise=noise), names="xyzi")
    return out.write()
