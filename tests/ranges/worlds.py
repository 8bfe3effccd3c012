"""Small worlds of ranges whose truth is known."""

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.ranges.network import RangeLog
from mapweave.sim.mixed_team import MixedRecording

BIAS = 0.3  # [m] of every pair


def driven(way: np.ndarray, begins: tuple[float, float, float], seconds: float = 60.0) -> Track:
    """A robot along `way` (corners in its own frame), at even speed, its frame at `begins`."""
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
    t = np.arange(0.0, seconds, 0.2)
    at = length[-1] * t / seconds
    p = np.column_stack([np.interp(at, length, way[:, k]) for k in (0, 1)])
    leg = np.clip(np.searchsorted(length, at, side="right") - 1, 0, len(way) - 2)
    heading = np.arctan2(*np.diff(way, axis=0)[leg].T[::-1])
    return Track(t, se2.compose(np.array(begins), np.column_stack([p, heading])))


SQUARE = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0], [0.0, 0.5]])
LINE = np.array([[0.0, 0.0], [6.0, 0.0]])
STILL = np.array([[0.0, 0.0], [1e-6, 0.0]])


def ranged(
    truth: dict[str, Track],
    beacons: dict[str, tuple[float, float]],
    nlos: float = 0.0,
    noise: float = 0.05,
    seed: int = 0,
) -> RangeLog:
    """Every pair ranges five times a second; odometry is the truth seen from where each robot began."""
    rng = np.random.default_rng(0)
    names, rows = [*truth, *beacons], []
    for i, a in enumerate(truth):
        for j in range(i + 1, len(names)):
            b = names[j]
            q = truth[b].pose[:, :2] if b in truth else np.array(beacons[b])
            d = np.hypot(*(truth[a].pose[:, :2] - q).T)
            z = d + BIAS + noise * rng.standard_normal(len(d))
            z += (rng.random(len(d)) < nlos) * (0.3 + rng.exponential(0.8, len(d)))
            rows.append((np.full(len(d), i), np.full(len(d), j), truth[a].t, z))
    odometry = {n: Track(k.t, se2.between(k.pose[0], k.pose)) for n, k in truth.items()}
    a, b, t, z = (np.concatenate(each) for each in zip(*rows, strict=True))
    return RangeLog(odometry, tuple(names), a, b, t, z)


def log_of(team: MixedRecording) -> RangeLog:
    """What the robots of a simulated team with radios logged."""
    odometry = {robot.name: robot.odometry for robot in team.robots}
    names = (*odometry, *team.landmarks)
    a, b = (
        np.concatenate([np.full(len(r.t), names.index(end)) for r, end in ends])
        for ends in ([(r, r.a) for r in team.ranges], [(r, r.b) for r in team.ranges])
    )
    t, z = (np.concatenate([getattr(r, name) for r in team.ranges]) for name in ("t", "z"))
    return RangeLog(odometry, names, a, b, t, z)
