"""EKF-SLAM of one robot, compiled: a camera frame, a stretch of commands, a whole log. State: see `ekf_state`."""

import numpy as np

from .._jit import kernel
from .ekf_apply_drive import apply_drive, coast, pose_covariance
from .ekf_drive import drive
from .ekf_sight import release, sight
from .ekf_start import begin, consider
from .ekf_state import Array, Noise, plain, wrap


@kernel
def frame(
    x: Array, P: Array, slots: Array, ranges: Array, bearings: Array, noise: Noise,
    started: Array, waiting: Array, n_waiting: Array, astray: Array, nis: Array, weight: Array,
) -> None:  # fmt: skip
    """All sightings of one camera frame (drive applied); fills `nis` and `weight`.

    A slot below zero is no landmark of this filter; it and a landmark that only waits get NaN.
    """
    size = len(x)
    U = np.empty((2 * len(slots), size))
    held = plain(0)
    for k in range(len(slots)):
        slot = slots[k]
        nis[k] = np.nan
        weight[k] = np.nan
        if slot < 0:
            continue
        if started[slot]:
            nis[k], weight[k] = sight(x, P, U, held, slot, ranges[k], bearings[k], noise, astray)
            held += 2
        elif consider(x, slot, ranges[k], bearings[k], noise, waiting, n_waiting):
            release(P, U, held)
            held = plain(0)
            begin(x, P, size, slot, ranges[k], bearings[k], noise)
            started[slot] = True
    release(P, U, held)


@kernel
def drive_rows(
    x: Array,
    P: Array,
    Phi: Array,
    Q: Array,
    t: float,
    cmd_t: Array,
    cmd_v: Array,
    cmd_w: Array,
    at: int,
    rows: int,
    noise: Noise,
    pose: Array,
    cov: Array,
) -> tuple[float, int]:
    """Drives to each of the last `rows` commands in turn; fills pose (rows, 3) and cov (rows, 6)."""
    n = len(cmd_t)
    for i in range(rows):
        k = n - rows + i
        t, at = drive(x, Phi, Q, t, cmd_t[k], cmd_t[: k + 1], cmd_v, cmd_w, at, noise)
        pose[i, 0], pose[i, 1], pose[i, 2] = x[0], x[1], wrap(x[2])
        pose_covariance(P, Phi, Q, cov[i])
    return t, at


@kernel
def drive_and_update(
    x: Array,
    P: Array,
    Phi: Array,
    Q: Array,
    t: float,
    now: float,
    cmd_t: Array,
    cmd_v: Array,
    cmd_w: Array,
    at: int,
    slots: Array,
    ranges: Array,
    bearings: Array,
    noise: Noise,
    started: Array,
    waiting: Array,
    n_waiting: Array,
    astray: Array,
    nis: Array,
    weight: Array,
    pose: Array,
    cov: Array,
) -> int:
    """Drives to `now` and works one camera frame in; fills pose (3) and cov (6); returns the command in force."""
    if noise.speed > 0.0:
        if now > t:
            coast(x, P, len(x), now - t, noise)
    else:
        t, at = drive(x, Phi, Q, t, now, cmd_t, cmd_v, cmd_w, at, noise)
        apply_drive(P, len(x), Phi, Q)
    frame(x, P, slots, ranges, bearings, noise, started, waiting, n_waiting, astray, nis, weight)
    pose[0], pose[1], pose[2] = x[0], x[1], wrap(x[2])
    pose_covariance(P, Phi, Q, cov)
    return at


@kernel
def replay(
    x: Array,
    P: Array,
    Phi: Array,
    Q: Array,
    t: float,
    cmd_t: Array,
    cmd_v: Array,
    cmd_w: Array,
    at: int,
    old: int,
    stamp: Array,
    slots: Array,
    ranges: Array,
    bearings: Array,
    noise: Noise,
    started: Array,
    waiting: Array,
    n_waiting: Array,
    astray: Array,
    nis: Array,
    weight: Array,
    track_t: Array,
    pose: Array,
    cov: Array,
) -> tuple[int, int]:
    """A stretch of a log through the filter: what its rows and frames one by one give, to the bit, in one call.

    t: where the filter stands [s]; at: the command in force, -1 before the first; old: commands known before this
    stretch. stamp, slots, ranges, bearings: (n,) sightings in order; nis, weight: (n,) filled; track_t, pose, cov:
    filled at every new odometry and sighting stamp. Returns the rows of the track and the command in force.
    """
    rows = j = 0
    i = old
    while i < len(cmd_t) or j < len(stamp):
        now = np.inf
        if i < len(cmd_t):
            now = cmd_t[i]
        if j < len(stamp):
            now = min(now, stamp[j])
        if i < len(cmd_t) and cmd_t[i] == now:
            i += 1
        first = j
        while j < len(stamp) and stamp[j] == now:
            j += 1
        if j > first:
            at = drive_and_update(
                x, P, Phi, Q, t, now, cmd_t[:i], cmd_v, cmd_w, at, slots[first:j], ranges[first:j], bearings[first:j],
                noise, started, waiting, n_waiting, astray, nis[first:j], weight[first:j], pose[rows], cov[rows],
            )  # fmt: skip
            t = now
        else:
            t, at = drive_rows(
                x,
                P,
                Phi,
                Q,
                t,
                cmd_t[:i],
                cmd_v,
                cmd_w,
                at,
                plain(1),
                noise,
                pose[rows : rows + 1],
                cov[rows : rows + 1],
            )
        track_t[rows] = now
        rows += 1
    return rows, at
