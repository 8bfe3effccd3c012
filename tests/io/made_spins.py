"""A robot without wheels that spins: what its scanner sees, and what an IMU on it tells."""

from itertools import pairwise

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Scan, Track, frozen
from mapweave.kernels.walls.segments import cast
from mapweave.sim.laser import Scanner, WallStyle, WorldBuilder

from .ros_logs import Recording

LEVEL = np.eye(3)
SCANNER = Scanner(beams=360, opening=2 * np.pi * 359 / 360, far=12.0)
WALLS = [(0, 0), (9, 0), (9, 3), (6, 3), (6, 7), (1, 7), (1, 5), (0, 5), (0, 0)]
BOXES = [(1.0, 0.6, 0.6, 0.4), (8.3, 0.8, 0.4, 0.5), (4.0, 5.6, 0.8, 0.5), (2.2, 6.2, 0.3, 0.3)]


def truth_of(seconds, rate, *, hz=100.0, speed=0.4):
    """The drive at `hz`: to and fro through the room, turning by up to `rate` [rad/s], one way and then the other."""
    t = np.arange(0.0, seconds, 1.0 / hz)
    w = rate * np.sign(np.sin(0.5 * t)) * np.minimum(1.0, 4 * np.abs(np.sin(0.5 * t)))
    heading = np.concatenate([[0.0], np.cumsum(w[:-1]) / hz])
    x, y = 4.5 + 3.0 * np.cos(speed / 3 * t), 2.6 + 1.2 * np.sin(2 * speed / 3 * t)
    return Track(1000.0 + t, np.column_stack([x, y, se2.wrap_angle(heading)])), w


def scans_of(truth, *, every=10, seed=0):
    """(stamps, scans) of the drive, each of one moment."""
    rng = np.random.default_rng(seed)
    build = WorldBuilder("room", WallStyle(), rng)
    for a, b in pairwise(WALLS):
        build.plain(a, b)
    for x, y, wide, deep in BOXES:
        build.box(x, y, wide, deep, 0.5)
    world = build.world()
    rows = np.arange(0, len(truth.t), every)
    r, what, _ = cast(truth.pose[rows], SCANNER.angles(), world.segments, np.zeros((len(rows), 0, 3)), SCANNER.far)
    r = np.where(what >= 0, r, SCANNER.far)
    r = r + np.maximum(0.01, 0.01 * r) * rng.normal(size=r.shape)
    hit = (what >= 0) & (r < SCANNER.range_max)
    light = None
    scans = [
        Scan(
            frozen(np.where(h, v, SCANNER.range_max)),
            frozen(h, bool),
            light,
            SCANNER.angle_min,
            SCANNER.angle_increment,
            SCANNER.range_max,
        )
        for v, h in zip(r, hit, strict=True)
    ]
    return truth.t[rows], scans


def spin_bag(
    path, truth, rate, *, scale=1.0, bias=0.0, mounted=LEVEL, felt=True, wheels=None, imu=True, seed=0, every=10
):
    """The drive as a recording: scans, the IMU at every row of `truth`, and wheels that tell `wheels` times the turns.

    mounted: (3, 3) turns the robot's axes into the unit's; felt: whether the unit tells accelerations.
    """
    out, rng = Recording(path), np.random.default_rng([seed, 1])
    for t, scan in zip(*scans_of(truth, seed=seed, every=every), strict=True):
        out.scan(t, scan.ranges, angles=scan.angles()[[0, -1]])
    for t, w in zip(truth.t, rate, strict=True) if imu else ():
        told = mounted @ (0.0, 0.0, scale * (w + bias + 0.02 * rng.normal()))
        out.imu(t, told, mounted @ (0.1 * rng.normal(), 0.1 * rng.normal(), 9.81) if felt else None)
    if wheels is not None:
        step = se2.between(truth.pose[:-1], truth.pose[1:])
        step[:, 2] *= wheels
        pose = [np.zeros(3)]
        for u in step:
            pose.append(se2.compose(pose[-1], u))
        for t, (x, y, yaw) in zip(truth.t, pose, strict=True):
            out.odom(t, x, y=y, yaw=yaw)
    out.rows.sort(key=lambda row: row[0])
    return out.write()


def error_of(track, truth):
    """(rms, greatest) distance [m] of a track from the truth, their first poses on each other."""
    at = se2.interpolate(track.t, truth.t, truth.pose)
    off = (se2.between(track.pose[0], track.pose) - se2.between(at[0], at))[:, :2]
    away = np.hypot(*off.T)
    return float(np.sqrt(np.mean(away**2))), float(away.max())
