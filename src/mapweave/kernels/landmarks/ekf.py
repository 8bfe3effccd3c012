"""EKF-SLAM of one robot, compiled: a camera frame, a stretch of commands, a whole log. State: see `ekf_state`."""

import numpy as np

from .._jit import kernel
from .ekf_apply_drive import apply_drive, coast, pose_covariance
from .ekf_drive import drive
from .ekf_sight import release, sight
from .ekf_start import begin, consider
from .ekf_state import Array, Belief, CameraFrame, Commands, LandmarkTable, Noise, UpdateOutcomes, plain, wrap


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
    belief: Belief, t: float, rows: Array, end: int, at: int, number: int, noise: Noise, pose: Array, cov: Array
) -> tuple[float, int]:
    """Drives to each of the `number` commands before number `end`; fills pose (number, 3) and cov (number, 6).

    rows: (3, k) commands t, v, w.
    """
    x, P, Phi, Q = belief
    for i in range(number):
        k = end - number + i
        t, at = drive(x, Phi, Q, t, rows[0, k], rows[0, : k + 1], rows[1], rows[2], at, noise)
        pose[i, 0], pose[i, 1], pose[i, 2] = x[0], x[1], wrap(x[2])
        pose_covariance(P, Phi, Q, cov[i])
    return t, at


@kernel
def drive_and_update(
    belief: Belief, t: float, now: float, commands: Commands, at: int, seen: CameraFrame, noise: Noise,
    places: LandmarkTable, fit: UpdateOutcomes, pose: Array, cov: Array,
) -> int:  # fmt: skip
    """Drives to `now` and works one camera frame in; fills pose (3) and cov (6); returns the command in force."""
    x, P, Phi, Q = belief
    if noise.speed > 0.0:
        if now > t:
            coast(x, P, len(x), now - t, noise)
    else:
        t, at = drive(x, Phi, Q, t, now, commands.t, commands.v, commands.w, at, noise)
        apply_drive(P, len(x), Phi, Q)
    frame(x, P, seen, noise, places, fit)
    pose[0], pose[1], pose[2] = x[0], x[1], wrap(x[2])
    pose_covariance(P, Phi, Q, cov)
    return at


@kernel
def replay(
    belief: Belief, t: float, rows: Array, at: int, old: int, slots: Array, sightings: Array, noise: Noise,
    places: LandmarkTable, fit: Array, track_t: Array, pose: Array, cov: Array,
) -> tuple[int, int]:  # fmt: skip
    """A stretch of a log through the filter: what its rows and frames one by one give, to the bit, in one call.

    t: where the filter stands [s]; rows: (3, k) commands t, v, w; at: the one in force, -1 before the first; old: those
    known before this stretch. slots: (n,), sightings: (3, n) stamp, range and bearing of each in order; filled are fit
    (2, n) with NIS and weight of each, track_t, pose (3) and cov (6) at every new odometry and sighting stamp. Returns
    how many these are and the command in force.
    """
    done = j = 0
    i = old
    stamp = sightings[0]
    while i < rows.shape[1] or j < len(stamp):
        now = np.inf
        if i < rows.shape[1]:
            now = rows[0, i]
        if j < len(stamp):
            now = min(now, stamp[j])
        if i < rows.shape[1] and rows[0, i] == now:
            i += 1
        first = j
        while j < len(stamp) and stamp[j] == now:
            j += 1
        if j > first:
            seen = CameraFrame(slots[first:j], sightings[1, first:j], sightings[2, first:j])
            commands = Commands(rows[0, :i], rows[1], rows[2])
            used = UpdateOutcomes(fit[0, first:j], fit[1, first:j])
            at = drive_and_update(belief, t, now, commands, at, seen, noise, places, used, pose[done], cov[done])
            t = now
        else:
            end = done + 1
            t, at = drive_rows(belief, t, rows, plain(i), at, plain(1), noise, pose[done:end], cov[done:end])
        track_t[done] = now
        done += 1
    return done, at
