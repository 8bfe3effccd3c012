"""One simulated robot among landmarks, with every bias the filter knows of, for tests of estimators."""

from dataclasses import dataclass

import numpy as np

from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Event, Odometry, Sightings


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


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


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
        far, bend = (v[u] * h, w[u] * h) if u >= 0 else (0.0, 0.0)
        along, across = 0.05 * np.sqrt(far) * rng.normal(), 0.02 * np.sqrt(far) * rng.normal()
        turn = np.sqrt(0.05**2 * far + 0.05**2 * abs(bend)) * rng.normal()
        x, y, theta = pose[k - 1]
        half = 0.5 * biases.turn_scale * bend
        c, s = np.cos(theta + half), np.sin(theta + half)
        ahead, aside = far * np.sinc(half / np.pi) + biases.noise * along, biases.noise * across
        pose[k] = x + c * ahead - s * aside, y + s * ahead + c * aside, theta + 2 * half + biases.noise * turn
        if k % 5 == 0:
            d = points - pose[k, :2]
            r, b = np.hypot(*d.T), wrap(np.arctan2(d[:, 1], d[:, 0]) - pose[k, 2])
            for name in np.flatnonzero((np.abs(b) < 1.2) & (r < 6.0)):
                z = biases.range_scale * r[name] + biases.noise * np.hypot(0.05, 0.045 * r[name]) * rng.normal()
                if rng.uniform() < biases.outliers:
                    z = rng.uniform(0.3, 8.0)
                bearing = b[name] + biases.bearing_bias + biases.noise * 0.014 * rng.normal()
                rows.append((t[k], name, max(z, 0.05), wrap(bearing)))
    pose[:, 2] = wrap(pose[:, 2])
    table = np.array(rows)
    ids = tuple(str(6 + k) for k in range(landmarks))
    seen = SightingTable(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3], ids)
    return LandmarkLog("robot1", Odometry(t, v, w), seen, source="simulated"), Truth(ids, points, t, pose)


def errors(submap, truth: Truth) -> np.ndarray:
    """(n, 2) landmark errors in the frame of the first pose."""
    return submap.mean - np.array([truth.points[truth.ids.index(name)] for name in submap.ids])


def one_by_one(log: LandmarkLog) -> list[Event]:
    """The log as a live robot tells it: every odometry row, then every camera frame, in an event of its own."""
    o, s = log.odometry, log.sightings
    rows = range(len(o.t)) if o is not None else ()
    events = [Event(o.t[k], log.robot, Odometry(o.t[k : k + 1], o.v[k : k + 1], o.w[k : k + 1])) for k in rows]
    for t in np.unique(s.t):
        at = s.t == t
        ids = tuple(s.ids[k] for k in s.what[at])
        events.append(Event(t, log.robot, Sightings(ids, s.range[at], s.bearing[at])))
    return sorted(events, key=lambda e: e.t)  # stable: a row at a frame's own stamp stays before it
