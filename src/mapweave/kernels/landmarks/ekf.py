"""EKF-SLAM of one robot: it drives along its commands, landmarks start, sightings are worked in; a frame, a log.

State `x`: [px, py, theta, v scale, turn scale, lag, bearing bias, range scale, p_1x, p_1y, ...]; `P` its covariance.
A parameter that is not estimated has zero variance and stays.

`Phi` (3, 8) is the pose's derivative by the pose and calibration the drive started from, `Q` (3, 3) the noise gathered.
Between sightings the covariance is not touched: they hold the drive since the last one.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from .._jit import kernel
from ..cells import cell_of

Array: TypeAlias = np.ndarray

POSE = 3  # entries of the state that are the pose; the calibration follows
HEAD = 8  # pose and calibration
# entries of the calibration in the state
V_SCALE, TURN_SCALE, LAG, BEARING_BIAS, RANGE_SCALE = 3, 4, 5, 6, 7


class Belief(NamedTuple):
    """The filter between two sightings: changed in place.

    x: (n,) and P: (n, n) as of the last sighting but for the pose in x; Phi: (3, HEAD), Q: (3, 3) of what was driven
    since then.
    """

    x: Array
    P: Array
    Phi: Array
    Q: Array


class Commands(NamedTuple):
    """t: (k,) stamps [s] from which on the robot drives v [m/s], w [rad/s]; v and w may be longer."""

    t: Array
    v: Array
    w: Array


class CameraFrame(NamedTuple):
    """n sightings: of which landmark (slot (n,), below zero of none), range [m] and bearing [rad]."""

    slot: Array
    range: Array
    bearing: Array


class SightingRows(NamedTuple):
    """n sightings in order: stamp t [s], of which landmark (slot, below zero of none), range [m], bearing [rad]."""

    t: Array
    slot: Array
    range: Array
    bearing: Array


class PoseRows(NamedTuple):
    """A trajectory to fill, a row a stamp: t [s], pose (n, 3) and its covariance."""

    t: Array
    pose: Array
    cov: Array


class LandmarkTable(NamedTuple):
    """What is known of each landmark, changed in place.

    started: (m,) whether it is in the state; waiting: (m, CANDIDATES, 2), filled: (m,) the places it was seen at
    before; astray: (1,) sightings in a row that hardly counted.
    """

    started: Array
    waiting: Array
    filled: Array
    astray: Array


class UpdateOutcomes(NamedTuple):
    """nis, weight: (n,) of each sighting, NaN where it was no update of a landmark; filled."""

    nis: Array
    weight: Array


class Noise(NamedTuple):
    """What the kernels take from the configuration, in metres, radians and seconds."""

    along: float  # [m / sqrt(m)] of distance commanded
    across: float  # [m / sqrt(m)]
    drift: float  # [rad / sqrt(m)] heading over distance commanded
    turn: float  # [rad / sqrt(rad)] heading over angle commanded
    rest_xy: float  # [m / sqrt(s)]
    rest_theta: float  # [rad / sqrt(s)]
    lost_xy: float  # [m / sqrt(s)] while no command is known
    lost_theta: float  # [rad / sqrt(s)]
    hold: float  # [s] a command is held at most
    speed: float  # [m/s] a robot without odometry drives at; 0: commands are known
    speed_time: float  # [s] it keeps its speed
    spin: float  # [rad/s] it turns at
    spin_time: float  # [s]
    range_floor: float  # [m]
    range_share: float  # of the distance
    bearing: float  # [rad]
    range_inflation: float  # of the variance, for correlated errors
    bearing_inflation: float
    gate: float  # normalised innovation from which a sighting counts less
    far: float  # normalised innovation from which it hardly counts
    agree: int  # sightings that must agree before a landmark starts


@kernel
def plain(number: int) -> int:
    """`number`, no longer a literal: Numba compiles a callee once more for each literal argument."""
    return number


@kernel
def quadratic(
    e0: float,
    e1: float,
    s00: float,
    s01: float,
    s11: float,
) -> float:
    """`e^T S^-1 e` in two dimensions."""
    q: float = (s11 * e0 * e0 - 2.0 * s01 * e0 * e1 + s00 * e1 * e1) / (s00 * s11 - s01 * s01)
    return q


@kernel
def wrap(
    angle: float,
) -> float:
    """`angle` [rad] in [-pi, pi)."""
    wrapped: float = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return wrapped


@kernel
def arc(
    x: Array,
    Phi: Array,
    Q: Array,
    v: float,
    w: float,
    dt: float,
    noise: Noise,
    known: bool,  # noqa: FBT001
) -> None:
    """The pose, its derivatives and its noise after `dt` [s] at commanded `v` [m/s] and `w` [rad/s] on an exact arc."""
    sv, sw = x[V_SCALE], x[TURN_SCALE]
    h = 0.5 * sw * w * dt
    if abs(h) < 1e-4:
        sinc, dsinc = 1.0 - h * h / 6.0, -h / 3.0
    else:
        sinc = np.sin(h) / h
        dsinc = (np.cos(h) - sinc) / h
    c, s = np.cos(x[2] + h), np.sin(x[2] + h)
    step = v * dt
    chord = sv * step * sinc
    dx, dy = chord * c, chord * s
    turn = 0.5 * w * dt  # dh / d(turn scale)
    chord_h = sv * step * dsinc
    for k in range(HEAD):
        theta = Phi[2, k]
        Phi[0, k] -= dy * theta
        Phi[1, k] += dx * theta
    Phi[0, V_SCALE] += step * sinc * c
    Phi[1, V_SCALE] += step * sinc * s
    Phi[0, TURN_SCALE] += (chord_h * c - dy) * turn
    Phi[1, TURN_SCALE] += (chord_h * s + dx) * turn
    Phi[2, TURN_SCALE] += w * dt
    # Q <- F Q F^T, F = I + [-dy, dx] on theta
    q02, q12, q22 = Q[0, 2], Q[1, 2], Q[2, 2]
    Q[0, 0] += -2.0 * dy * q02 + dy * dy * q22
    Q[0, 1] += dx * q02 - dy * q12 - dx * dy * q22
    Q[1, 1] += 2.0 * dx * q12 + dx * dx * q22
    Q[0, 2] -= dy * q22
    Q[1, 2] += dx * q22
    far, bend = abs(step), abs(w) * dt
    if known:
        rest = noise.rest_xy * noise.rest_xy * dt
        along = noise.along * noise.along * far + rest
        across = noise.across * noise.across * far + rest
        heading = noise.drift * noise.drift * far + noise.turn * noise.turn * bend + noise.rest_theta**2 * dt
    else:
        along = noise.lost_xy * noise.lost_xy * dt
        across = along
        heading = noise.lost_theta * noise.lost_theta * dt
    Q[0, 0] += c * c * along + s * s * across
    Q[0, 1] += c * s * (along - across)
    Q[1, 1] += s * s * along + c * c * across
    Q[2, 2] += heading
    Q[1, 0], Q[2, 0], Q[2, 1] = Q[0, 1], Q[0, 2], Q[1, 2]
    x[0] += dx
    x[1] += dy
    x[2] += 2.0 * h


@kernel
def drive(
    x: Array,
    Phi: Array,
    Q: Array,
    t: float,
    until: float,
    commands: Commands,
    at: int,
    noise: Noise,
) -> tuple[float, int]:
    """Drives from `t` to `until` [s]; returns the time and command then in force.

    Command i holds from its stamp + lag until the next one, but `noise.hold` at most; then, and before the first
    command was given, the robot may go anywhere. `at` is the command in force, -1 before the first.
    """
    n = len(commands.t)
    lag = x[LAG]
    while t < until:
        v = w = 0.0
        known = n > 0 and commands.t[0] <= t
        expiry = np.inf
        if at >= 0:
            expiry = commands.t[at] + lag + noise.hold
            if t < expiry:
                v, w = commands.v[at], commands.w[at]
            else:
                known, expiry = False, np.inf
        follows = commands.t[at + 1] + lag if at + 1 < n else np.inf
        end = min(until, follows, expiry)
        if end > t:
            arc(x, Phi, Q, v, w, end - t, noise, known)
            t = end
        if follows <= end:
            at += 1
            dv, dw = v - commands.v[at], w - commands.w[at]
            Phi[0, LAG] += x[V_SCALE] * dv * np.cos(x[2])
            Phi[1, LAG] += x[V_SCALE] * dv * np.sin(x[2])
            Phi[2, LAG] += x[TURN_SCALE] * dw
    return t, at


COAST_STEP = 0.1  # [s]


@kernel
def apply_drive(
    P: Array,
    size: int,
    Phi: Array,
    Q: Array,
) -> None:
    """Works the drive since the last sighting into `P` and clears it."""
    rows = np.zeros((POSE, size))
    for i in range(POSE):
        for j in range(size):
            total = 0.0
            for k in range(HEAD):
                total += Phi[i, k] * P[k, j]
            rows[i, j] = total
    for i in range(POSE):
        for j in range(POSE, size):
            P[i, j] = rows[i, j]
            P[j, i] = rows[i, j]
    for i in range(POSE):
        for j in range(i, POSE):
            total = Q[i, j]
            for k in range(HEAD):
                total += rows[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total
    clear(Phi, Q)


@kernel
def clear(
    Phi: Array,
    Q: Array,
) -> None:
    """No drive since the last sighting."""
    Phi[:, :] = 0.0
    Q[:, :] = 0.0
    for i in range(POSE):
        Phi[i, i] = 1.0


@kernel
def pose_covariance(
    P: Array,
    Phi: Array,
    Q: Array,
    out: Array,
) -> None:
    """The pose's covariance now, (xx, xy, xt, yy, yt, tt) into `out`, with the drive that is not applied."""
    k = 0
    for i in range(POSE):
        for j in range(i, POSE):
            total = Q[i, j]
            for a in range(HEAD):
                inner = 0.0
                for b in range(HEAD):
                    inner += P[a, b] * Phi[j, b]
                total += Phi[i, a] * inner
            out[k] = total
            k += 1


@kernel
def coast(x: Array, P: Array, size: int, dt: float, noise: Noise) -> None:
    """`dt` [s] of a robot without odometry: it keeps speed and turn rate, and forgets them slowly.

    Then `x[V_SCALE]` is its speed [m/s] and `x[TURN_SCALE]` its turn rate [rad/s], each an Ornstein-Uhlenbeck process.
    """
    steps = max(1, cell_of(np.ceil(dt / COAST_STEP)))
    h = dt / steps
    keep_v, keep_w = np.exp(-h / noise.speed_time), np.exp(-h / noise.spin_time)
    Phi, Q = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    for _ in range(steps):
        clear(Phi, Q)
        arc(x, Phi, Q, 1.0, 1.0, h, noise, plain(0) > 0)
        apply_drive(P, size, Phi, Q)
        x[V_SCALE] *= keep_v
        x[TURN_SCALE] *= keep_w
        for j in range(size):
            P[V_SCALE, j] *= keep_v
            P[TURN_SCALE, j] *= keep_w
        for j in range(size):
            P[j, V_SCALE] *= keep_v
            P[j, TURN_SCALE] *= keep_w
        P[V_SCALE, V_SCALE] += noise.speed**2 * (1.0 - keep_v**2)
        P[TURN_SCALE, TURN_SCALE] += noise.spin**2 * (1.0 - keep_w**2)


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
