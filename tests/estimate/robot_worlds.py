"""One simulated robot among landmarks, with every bias the filter knows of, for tests of estimators."""

from dataclasses import dataclass

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Odometry
from mapweave.models import motion, range_bearing
from mapweave.readers.landmark_log import LandmarkLog, SightingTable


@dataclass(frozen=True)
class Truth:
    ids: tuple[str, ...]
    points: np.ndarray  # in the frame of the first pose
    t: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class Biases:
    turn_scale: float = 1.0
    lag: float = 0.0
    bearing_bias: float = 0.0
    range_scale: float = 1.0
    noise: float = 1.0  # of motion and readings alike
    outliers: float = 0.0  # share of ranges that are anything


def drive(seed: int, seconds: float = 60.0, biases: Biases = Biases(), landmarks: int = 8) -> tuple[LandmarkLog, Truth]:
    """A robot wandering through 6 x 6 m at 0.1 m/s: odometry at 20 Hz, a frame of all landmarks ahead at 4 Hz."""
    rng = np.random.default_rng(seed)
    h, t0 = 0.05, 1000.0
    n = int(seconds / h)
    v = np.full(n, 0.1)
    w = np.repeat(rng.uniform(-0.4, 0.4, n // 40 + 1), 40)[:n]
    points = rng.uniform(-3.0, 3.0, (landmarks, 2))
    points += 0.6 * points / np.maximum(np.hypot(*points.T), 0.1)[:, None]
    t = t0 + h * np.arange(n)
    delay = round(biases.lag / h)
    pose = np.zeros((n, 3))
    rows = []
    for k in range(1, n):
        u = k - 1 - delay
        far, bend = (v[u] * h, abs(w[u]) * h) if u >= 0 else (0.0, 0.0)
        speed, spin = (v[u], biases.turn_scale * w[u]) if u >= 0 else (0.0, 0.0)
        p = motion.unicycle(pose[k - 1], speed, spin, h)
        along, across = 0.05 * np.sqrt(far) * rng.normal(), 0.02 * np.sqrt(far) * rng.normal()
        turn = np.sqrt(0.05**2 * far + 0.05**2 * bend) * rng.normal()
        pose[k] = se2.compose(p, biases.noise * np.array([along, across, turn]))
        if k % 5 == 0:
            for name, point in enumerate(points):
                r, b = range_bearing.observe(pose[k], point)
                if abs(b) < 1.2 and r < 6.0:
                    z = biases.range_scale * r + biases.noise * np.hypot(0.05, 0.045 * r) * rng.normal()
                    if rng.uniform() < biases.outliers:
                        z = rng.uniform(0.3, 8.0)
                    bearing = b + biases.bearing_bias + biases.noise * 0.014 * rng.normal()
                    rows.append((t[k], name, max(z, 0.05), se2.wrap_angle(bearing)))
    table = np.array(rows)
    ids = tuple(str(6 + k) for k in range(landmarks))
    seen = SightingTable(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3], ids)
    return LandmarkLog("robot1", Odometry(t, v, w), seen, source="simulated"), Truth(ids, points, t, pose)


def errors(submap, truth: Truth) -> np.ndarray:
    """(n, 2) landmark errors in the frame of the first pose."""
    return submap.mean - np.array([truth.points[truth.ids.index(name)] for name in submap.ids])
