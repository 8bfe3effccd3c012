"""EKF-SLAM of one robot: landmarks start, sightings are worked in; a camera frame, a stretch of commands, a log."""

import numpy as np

from .._jit import kernel
from .ekf_drive import apply_drive, coast, drive, pose_covariance
from .ekf_state import (
    BEARING_BIAS,
    HEAD,
    RANGE_SCALE,
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
    quadratic,
    wrap,
)

CANDIDATES = 8  # sightings of a landmark not yet started that are remembered


@kernel
def consider(
    x: Array,
    slot: int,
    z_range: float,
    z_bearing: float,
    noise: Noise,
    waiting: Array,
    n_waiting: Array,
) -> bool:
    """Whether a landmark not yet started may start with this sighting: enough remembered ones agree on its place.

    waiting: (slots, CANDIDATES, 2) places seen so far, the oldest overwritten; n_waiting: (slots,) how many there were.
    """
    r = z_range / x[RANGE_SCALE]
    phi = x[2] + z_bearing - x[BEARING_BIAS]
    px, py = x[0] + r * np.cos(phi), x[1] + r * np.sin(phi)
    spread = noise.range_floor**2 + (noise.range_share * r) ** 2 + (noise.bearing * r) ** 2
    agree = 1
    for k in range(min(n_waiting[slot], CANDIDATES)):
        dx, dy = waiting[slot, k, 0] - px, waiting[slot, k, 1] - py
        if dx * dx + dy * dy < 9.0 * 2.0 * spread:
            agree += 1
    k = n_waiting[slot] % CANDIDATES
    waiting[slot, k, 0], waiting[slot, k, 1] = px, py
    n_waiting[slot] += 1
    return agree >= noise.agree


@kernel
def begin(
    x: Array,
    P: Array,
    size: int,
    slot: int,
    z_range: float,
    z_bearing: float,
    noise: Noise,
) -> None:
    """Starts the landmark of `slot` from one sighting (drive applied), with its cross-covariances."""
    a = HEAD + 2 * slot
    s = x[RANGE_SCALE]
    r = z_range / s
    phi = x[2] + z_bearing - x[BEARING_BIAS]
    c, n = np.cos(phi), np.sin(phi)
    x[a] = x[0] + r * c
    x[a + 1] = x[1] + r * n
    where = np.array([0, 1, 2, BEARING_BIAS, RANGE_SCALE])
    G = np.array([[1.0, 0.0, -r * n, r * n, -r * c / s], [0.0, 1.0, r * c, -r * c, -r * n / s]])
    for i in range(2):
        for j in range(size):
            total = 0.0
            for k in range(5):
                total += G[i, k] * P[where[k], j]
            P[a + i, j] = total
    for j in range(size):
        P[j, a], P[j, a + 1] = P[a, j], P[a + 1, j]
    v0 = (noise.range_floor**2 + (noise.range_share * r) ** 2) * noise.range_inflation / (s * s)
    v1 = noise.bearing**2 * noise.bearing_inflation * r * r
    N = np.array([[c * c * v0 + n * n * v1, c * n * (v0 - v1)], [c * n * (v0 - v1), n * n * v0 + c * c * v1]])
    for i in range(2):
        for j in range(2):
            total = N[i, j]
            for k in range(5):
                total += P[a + i, where[k]] * G[j, k]
            P[a + i, a + j] = total


DOUBT = 3  # far sightings in a row that are taken for wrong labels


@kernel
def sight(
    x: Array, P: Array, U: Array, held: int, slot: int, z_range: float, z_bearing: float, noise: Noise, astray: Array
) -> tuple[float, float]:
    """One sighting of a started landmark worked into `x`, its rank two of `P` into U[held : held + 2]: (NIS, weight).

    The covariance is `P - U[:held]^T U[:held]`: a frame's sightings are worked in one by one, but `P`, large, is
    passed over once. Noise is taken at the predicted distance: the measured one favours short readings. A sighting
    far from the prediction counts less, by `trust`, never nothing.
    """
    size = len(x)
    a = HEAD + 2 * slot
    dx, dy = x[a] - x[0], x[a + 1] - x[1]
    r = max(np.sqrt(dx * dx + dy * dy), 1e-6)
    s = x[RANGE_SCALE]
    e0 = z_range - s * r
    e1 = wrap(z_bearing - np.arctan2(dy, dx) + x[2] - x[BEARING_BIAS])
    where = np.array([0, 1, 2, BEARING_BIAS, RANGE_SCALE, a, a + 1])
    ux, uy = dx / r, dy / r
    gx, gy = -dy / (r * r), dx / (r * r)
    H = np.array([[-s * ux, -s * uy, 0.0, 0.0, r, s * ux, s * uy], [-gx, -gy, -1.0, 1.0, 0.0, gx, gy]])
    PHt = np.zeros((2, size))
    for k in range(7):
        add(PHt[0], P[where[k]], H[0, k])
        add(PHt[1], P[where[k]], H[1, k])
    for q in range(held):
        h0 = h1 = 0.0
        for k in range(7):
            h0 += H[0, k] * U[q, where[k]]
            h1 += H[1, k] * U[q, where[k]]
        add(PHt[0], U[q], -h0)
        add(PHt[1], U[q], -h1)
    s00 = s01 = s11 = 0.0
    for k in range(7):
        j = where[k]
        s00 += H[0, k] * PHt[0, j]
        s01 += H[0, k] * PHt[1, j]
        s11 += H[1, k] * PHt[1, j]
    r0 = noise.range_floor**2 + (noise.range_share * r) ** 2
    r1 = noise.bearing**2
    nis = quadratic(e0, e1, s00 + r0, s01, s11 + r1)
    d = np.sqrt(nis)
    weight = trust(d, noise, astray)
    l00 = np.sqrt(s00 + r0 * noise.range_inflation / weight)  # S = L L^T, U = L^-1 H P
    l10 = s01 / l00
    l11 = np.sqrt(s11 + r1 * noise.bearing_inflation / weight - l10 * l10)
    y0 = e0 / l00
    y1 = (e1 - l10 * y0) / l11
    for j in range(size):
        u0 = PHt[0, j] / l00
        u1 = (PHt[1, j] - l10 * u0) / l11
        U[held, j], U[held + 1, j] = u0, u1
        x[j] += u0 * y0 + u1 * y1
    return nis, weight


@kernel
def trust(d: float, noise: Noise, astray: Array) -> float:
    """How much a sighting of normalised innovation `d` counts: all, gate / d, and beyond `far` less by its square.

    That last only while few far ones have come in a row, counted in astray[0]: then it is a wrong label. When all
    are far it is the robot that is elsewhere, and it must find back.
    """
    if d <= noise.gate:
        astray[0] = 0
        return 1.0
    weight: float = noise.gate / d
    if d > noise.far:
        astray[0] += 1
        if astray[0] <= DOUBT:
            weight *= (noise.far / d) ** 2
    return weight


@kernel
def add(to: Array, row: Array, factor: float) -> None:
    """`to += factor * row`, contiguous."""
    for j in range(len(to)):
        to[j] += factor * row[j]


@kernel
def release(P: Array, U: Array, held: int) -> None:
    """`P -= U[:held]^T U[:held]`, symmetric to the bit; `held` is even."""
    n = len(P)
    for i in range(n):
        row = P[i]
        q = 0
        while q + 4 <= held:
            a, b, c, d = U[q], U[q + 1], U[q + 2], U[q + 3]
            ai, bi, ci, di = a[i], b[i], c[i], d[i]
            for j in range(n):
                row[j] -= (ai * a[j] + bi * b[j]) + (ci * c[j] + di * d[j])
            q += 4
        if q < held:
            a, b = U[q], U[q + 1]
            ai, bi = a[i], b[i]
            for j in range(n):
                row[j] -= ai * a[j] + bi * b[j]


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
