"""Stamps of a robot's camera that are off those of its wheels, found in its own log and put right.

Between two frames a landmark moves in the picture as the wheels say that the robot did: mostly it turns the other way.
Carried from one frame to the next by what the wheels told some seconds earlier or later, bearings fit when the shift is
that between both clocks; no map and no filter is needed.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.config import config
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry
from ..core.rows import spread
from ..landmarks.ekf_slam import is_landmark
from .commanded_motion import CommandedMotion
from .config import CalibrationPrior, MotionNoise


@config
class CameraClockConfig:
    """How far a camera's clock is looked for, and when it is believed to be off that of the wheels."""

    reach: float = 5.0  # [s] looked for either way,
    step: float = 0.1  # and the steps
    apart: float = 1.5  # [s] between two sightings of one landmark that are compared, at most
    most: int = 800  # pairs compared
    few: int = 100  # pairs below which nothing is told
    bearing: float = 0.05  # [rad] by which a bearing carried along errs
    least: float = 0.5  # [s] from which a clock is off: less is how late wheels obey and cameras tell
    gain: float = 30.0  # cost that the shift must take away,
    share: float = 0.35  # and that share of it


def on_camera_clock(log: LandmarkLog, cfg: CameraClockConfig | None = None) -> LandmarkLog:
    """The log with its wheels' stamps on the camera's clock, told, where that is clearly another one.

    The camera's stamps stay: other robots' clocks are compared with them.
    """
    ahead = camera_ahead(log, cfg or CameraClockConfig())
    if not ahead or log.odometry is None:
        return log
    where = "ahead of" if ahead > 0 else "behind"
    told = f"its camera's stamps are {abs(ahead):.1f} s {where} its wheels', which were moved to them"
    return replace(log, odometry=replace(log.odometry, t=log.odometry.t + ahead), warnings=(*log.warnings, told))


def camera_ahead(log: LandmarkLog, cfg: CameraClockConfig) -> float:
    """By how much [s] the camera's stamps are ahead of the wheels'; 0 where they are not clearly, or nothing tells."""
    if log.odometry is None or not len(log.odometry.t):
        return 0.0
    a, b = _pairs(log, cfg).T
    if len(a) < cfg.few:
        return 0.0
    shift = cfg.step * np.arange(-round(cfg.reach / cfg.step), round(cfg.reach / cfg.step) + 1)
    cost = _costs(log.sightings, log.odometry, a, b, shift, cfg)
    k, usual = int(np.argmin(cost)), float(cost[np.abs(shift) < cfg.least].min())
    if not np.isfinite(cost).all():
        return 0.0
    gain = usual - float(cost[k])
    return float(shift[k]) if gain > max(cfg.gain, cfg.share * usual) else 0.0


def _pairs(log: LandmarkLog, cfg: CameraClockConfig) -> Int[np.ndarray, "p 2"]:
    """Sightings of a landmark and the next of the same one, spread over the log."""
    seen, found = log.sightings, [np.zeros((0, 2), np.int64)]
    for k, name in enumerate(seen.ids):
        rows = np.flatnonzero(seen.what == k) if is_landmark(name) else np.zeros(0, np.int64)
        gap = np.diff(seen.t[rows])
        near = (gap > 0.0) & (gap <= cfg.apart)
        found.append(np.column_stack([rows[:-1][near], rows[1:][near]]) if len(rows) else found[0])
    pairs = np.concatenate(found)
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    return np.asarray(pairs[spread(len(pairs), cfg.most)])


def _costs(
    seen: SightingTable,
    wheels: Odometry,
    a: Int[np.ndarray, " p"],
    b: Int[np.ndarray, " p"],
    shift: Float[np.ndarray, " s"],
    cfg: CameraClockConfig,
) -> Float[np.ndarray, " s"]:
    """The Cauchy cost of all pairs for each shift; a command that acts late is no shift."""
    usual = CalibrationPrior()
    motion = CommandedMotion.of(wheels, MotionNoise().hold)

    def at(k: Int[np.ndarray, " p"]) -> Float[np.ndarray, "s p 3"]:
        t = (seen.t[k] - shift[:, None]).ravel()
        return motion.at(t, usual.speed_scale, usual.turn_scale, usual.lag)[0].reshape(len(shift), len(k), 3)

    point = seen.range[a, None] * np.stack([np.cos(seen.bearing[a]), np.sin(seen.bearing[a])], axis=-1)
    carried = se2.act(se2.between(at(b), at(a)), point)
    miss = se2.wrap_angle(np.arctan2(carried[..., 1], carried[..., 0]) - seen.bearing[b])
    return np.asarray(np.log1p(np.square(miss / cfg.bearing)).sum(axis=-1))
