"""A whole log through EKF-SLAM's kernels in one call: what stepping its events gives, to the bit."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import EstimateError
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from ..kernels.landmarks import ekf, ekf_smooth
from ..kernels.landmarks.ekf_apply_drive import settle
from ..kernels.landmarks.ekf_start import CANDIDATES
from ..kernels.landmarks.ekf_state import POSE, RANGE_SCALE
from . import ekf_slam
from .config import EkfSlamConfig, noise, track_noise
from .submap import Submap

MOST_NUMBERS = 30_000_000  # sightings times state: beyond, smoothing would take gigabytes and poses stay filtered

LARGEST = 1e100  # [m], [m^2]: beyond, products of two numbers of the estimate are no longer finite


@dataclass(frozen=True, slots=True)
class Played:
    """A log played to its end.

    x, P: the filter's last state; nis, weight: (n,) of each row of `seen`, NaN where it was no update of a landmark.
    """

    seen: SightingTable
    x: Float[np.ndarray, " m"]
    P: Float[np.ndarray, "m m"]
    submap: Submap
    track: Track
    nis: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    warnings: tuple[str, ...] = ()


def play(log: LandmarkLog, cfg: EkfSlamConfig) -> Played:
    """EKF-SLAM over `log`; raises EstimateError when it leaves finite numbers."""
    seen = log.sightings
    used, first = np.unique(seen.what, return_index=True)
    order = used[np.argsort(first)]  # slots in the order of first sighting, as stepping gives them
    order = np.array([k for k in order if ekf_slam.is_landmark(seen.ids[k])], dtype=np.int64)
    slot = np.full(len(seen.ids), -1, np.int64)
    slot[order] = np.arange(len(order))
    slots, ids, n = slot[seen.what], tuple(seen.ids[k] for k in order), len(order)
    state = ekf_slam.with_slots(ekf_slam.initial(log.robot, cfg), ids)
    x, P, Phi, Q = state.x.copy(), state.P.copy(), state.Phi.copy(), state.Q.copy()
    started, waiting, n_waiting = np.zeros(n, bool), np.zeros((n, CANDIDATES, 2)), np.zeros(n, np.int64)
    odometry = log.odometry
    commands = [np.zeros(0)] * 3 if odometry is None else [odometry.t, odometry.v, odometry.w]
    nis, weight = np.empty(len(seen)), np.empty(len(seen))
    most = len(commands[0]) + len(seen)
    t, pose, cov = np.empty(most), np.empty((most, POSE)), np.empty((most, 6))
    start = min((float(s[0]) for s in (commands[0], seen.t) if len(s)), default=0.0)
    cmd_t, cmd_v, cmd_w = (np.array(c) for c in commands)
    stamp, distance, bearing = (np.array(c) for c in (seen.t, seen.range, seen.bearing))
    failed = EstimateError(f"{log.source}: {log.robot}: EKF-SLAM left finite numbers")
    try:
        rows = ekf.replay(
            x, P, Phi, Q, start, cmd_t, cmd_v, cmd_w, stamp, slots, distance, bearing,
            noise(cfg), started, waiting, n_waiting, np.zeros(1, np.int64), nis, weight, t, pose, cov,
        )  # fmt: skip
    except ZeroDivisionError:  # an innovation's determinant ran over
        raise failed from None
    settle(P, len(x), Phi, Q)
    if not max(np.abs(x).max(), np.abs(P).max(initial=0.0)) < LARGEST:
        raise failed
    made = ekf_slam.submap(log.robot, state.frame, x, P, ids, started)
    t, pose, square = t[:rows], pose[:rows], np.array(ekf_slam.square(cov[:rows]))
    if cfg.smooth and started.any() and len(seen) * len(x) <= MOST_NUMBERS:
        used_slots = np.where((slots >= 0) & started[slots], slots, -1)
        ekf_smooth.smooth(
            x, P, start, cmd_t, cmd_v, cmd_w, stamp, np.unique(stamp), used_slots, distance, bearing, track_noise(cfg),
            t, pose, square,
        )  # fmt: skip
    scale = float(x[RANGE_SCALE])
    by = np.array([scale, scale, 1.0])
    track = Track(t, pose * by, square * np.outer(by, by), state.frame)
    if not (np.isfinite(pose).all() and np.isfinite(square).all()):
        raise failed
    return Played(seen, x, P, made, track, nis, weight)
