"""EKF-SLAM of one robot, compiled: a camera frame, a stretch of commands, a whole log. State: see `ekf_state`."""

import numpy as np

from .._jit import kernel
from .ekf_apply_drive import apply_drive, coast, pose_covariance
from .ekf_drive import drive
from .ekf_sight import release, sight
from .ekf_start import begin, consider
from .ekf_state import (
    Array,
    Belief,
    CameraFrame,
    Commands,
    LandmarkTable,
    Noise,
    PoseRows,
    SightingRows,
    UpdateOutcomes,
    plain,
    wrap,
)


@kernel
def frame(x: Array, P: Array, seen: CameraFrame, noise: Noise, places: LandmarkTable, fit: UpdateOutcomes) -> None:
    """All sightings of one camera frame (drive applied); fills `fit`.

    A slot below zero is no landmark of this filter; it and a landmark that only waits get NaN.
    """
    size = len(x)
    U = np.empty((2 * len(seen.slot), size))
    held = plain(0)
    for k in range(len(seen.slot)):
        slot = seen.slot[k]
        fit.nis[k] = np.nan
        fit.weight[k] = np.nan
        if slot < 0:
            continue
        if places.started[slot]:
            fit.nis[k], fit.weight[k] = sight(x, P, U, held, slot, seen.range[k], seen.bearing[k], noise, places.astray)
            held += 2
        elif consider(x, slot, seen.range[k], seen.bearing[k], noise, places.waiting, places.filled):
            release(P, U, held)
            held = plain(0)
            begin(x, P, size, slot, seen.range[k], seen.bearing[k], noise)
            places.started[slot] = True
    release(P, U, held)


@kernel
def drive_rows(
    belief: Belief, t: float, commands: Commands, end: int, at: int, number: int, noise: Noise, pose: Array, cov: Array
) -> tuple[float, int]:
    """Drives to each of the `number` commands before number `end`; fills pose (number, 3) and cov (number, 6)."""
    x, P, Phi, Q = belief
    for i in range(number):
        k = end - number + i
        given = Commands(commands.t[: k + 1], commands.v, commands.w)
        t, at = drive(x, Phi, Q, t, commands.t[k], given, at, noise)
        pose[i, 0], pose[i, 1], pose[i, 2] = x[0], x[1], wrap(x[2])
        pose_covariance(P, Phi, Q, cov[i])
    return t, at


@kernel
def drive_and_update(
    belief: Belief, span: tuple[float, float], commands: Commands, at: int, seen: CameraFrame, noise: Noise,
    places: LandmarkTable, fit: UpdateOutcomes, pose: Array, cov: Array,
) -> int:  # fmt: skip
    """Drives from the first stamp of `span` [s] to the second and works one camera frame in.

    Fills pose (3) and cov (6); returns the command in force.
    """
    x, P, Phi, Q = belief
    t, now = span
    if noise.speed > 0.0:
        if now > t:
            coast(x, P, len(x), now - t, noise)
    else:
        t, at = drive(x, Phi, Q, t, now, commands, at, noise)
        apply_drive(P, len(x), Phi, Q)
    frame(x, P, seen, noise, places, fit)
    pose[0], pose[1], pose[2] = x[0], x[1], wrap(x[2])
    pose_covariance(P, Phi, Q, cov)
    return at


@kernel
def replay(
    belief: Belief, t: float, commands: Commands, at: int, old: int, sightings: SightingRows, noise: Noise,
    places: LandmarkTable, fit: UpdateOutcomes, track: PoseRows,
) -> tuple[int, int]:  # fmt: skip
    """A stretch of a log through the filter: what its rows and frames one by one give, to the bit, in one call.

    t: where the filter stands [s]; at: the command in force, -1 before the first; old: those known before this stretch.
    Filled are `fit` for each sighting and `track`, cov (n, 6), at every new odometry and sighting stamp. Returns how
    many these are and the command in force.
    """
    done = j = 0
    i = old
    stamp, k = sightings.t, len(commands.t)
    while i < k or j < len(stamp):
        now = np.inf
        if i < k:
            now = commands.t[i]
        if j < len(stamp):
            now = min(now, stamp[j])
        if i < k and commands.t[i] == now:
            i += 1
        first = j
        while j < len(stamp) and stamp[j] == now:
            j += 1
        if j > first:
            seen = CameraFrame(sightings.slot[first:j], sightings.range[first:j], sightings.bearing[first:j])
            given = Commands(commands.t[:i], commands.v, commands.w)
            used = UpdateOutcomes(fit.nis[first:j], fit.weight[first:j])
            pose_now, cov_now = track.pose[done], track.cov[done]
            at = drive_and_update(belief, (t, now), given, at, seen, noise, places, used, pose_now, cov_now)
            t = now
        else:
            end = done + 1
            pose, cov = track.pose[done:end], track.cov[done:end]
            t, at = drive_rows(belief, t, commands, plain(i), at, plain(1), noise, pose, cov)
        track.t[done] = now
        done += 1
    return done, at
