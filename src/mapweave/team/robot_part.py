"""What one robot brings into its team's problem: when its pose is estimated, and where that stands among the variables.

A pose is estimated whenever the robot sees or is seen, and so often that nothing long lies between. Between any two
instants its commands say where it went, and how that changes with its calibration.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry, Track
from ..laser.robot_graph import RobotGraph
from .config import UNKNOWN_SLIP, UNKNOWN_SPEED, UNKNOWN_SPIN, MotionNoise, SmoothingConfig

MOTION_REST_XY = 1e-3  # [m / sqrt(s)] of wandering in place, always there
MOTION_REST_THETA = 1e-3  # [rad / sqrt(s)] of the heading
MOTION_LOST_XY = 0.06  # [m / sqrt(s)] of wandering while no command is known
MOTION_LOST_THETA = 0.3  # [rad / sqrt(s)] of turning while no command is known

SPEED, TURN, LAG = range(3)  # the order of derivatives by calibration


@dataclass(frozen=True, slots=True)
class Motion:
    """Between n - 1 pairs of neighbouring instants: `T_before_after` as commanded, in the robot's frame before.

    step: (n-1, 3); by_calibration: (n-1, 3, 3), its derivatives by speed scale, turn scale and lag [s].
    """

    step: Float[np.ndarray, "m 3"]
    by_calibration: Float[np.ndarray, "m 3 3"]


@dataclass(frozen=True, slots=True)
class CommandedMotion:
    """The commands of one robot. t: (r,) [s] ascending; v: (r,) [m/s]; w: (r,) [rad/s]; dt: (r,) [s] each one held."""

    t: Float[np.ndarray, " r"]
    v: Float[np.ndarray, " r"]
    w: Float[np.ndarray, " r"]
    dt: Float[np.ndarray, " r"]

    @classmethod
    def of(cls, odometry: Odometry, hold: float) -> "CommandedMotion":
        """A command holds until the next one, but no longer than `hold` [s]."""
        last = np.append(np.diff(odometry.t), hold)
        return cls(odometry.t, odometry.v, odometry.w, np.minimum(last, hold))

    def at(
        self, t: Float[np.ndarray, " n"], speed: float, turn: float, lag: float
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Poses (n, 3) at `t` [s] in the frame of the start, and their derivatives (n, 3, 3) by the calibration.

        The robot does at t what was commanded at t - lag, on exact arcs, with v and w scaled.
        """
        heading = turn * _before(self.w * self.dt)
        by_turn = _before(self.w * self.dt)
        step, step_by_turn = _arc(self.v, self.w, self.dt, heading, by_turn, turn)
        origin, origin_by_turn = _before(step), _before(step_by_turn)
        k, part, running = self._row(t - lag)
        v, w = self.v[k], self.w[k]
        more, more_by_turn = _arc(v, w, part, heading[k], by_turn[k], turn)
        pose = np.empty((len(t), 3))
        pose[:, :2] = speed * (origin[k] + more)
        pose[:, 2] = heading[k] + turn * w * part
        d = np.empty((len(t), 3, 3))
        d[:, :2, SPEED], d[:, 2, SPEED] = origin[k] + more, 0.0
        d[:, :2, TURN], d[:, 2, TURN] = speed * (origin_by_turn[k] + more_by_turn), by_turn[k] + w * part
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        d[:, :, LAG] = -running[:, None] * np.stack([speed * v * c, speed * v * s, turn * w], axis=-1)
        return pose, d

    def between(self, t: Float[np.ndarray, " n"], speed: float, turn: float, lag: float) -> Motion:
        """The commanded motion from each of `t` [s], ascending, to the next."""
        pose, d = self.at(t, speed, turn, lag)
        c, s = np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
        dx, dy = np.diff(pose[:, 0]), np.diff(pose[:, 1])
        step = np.stack([c * dx + s * dy, -s * dx + c * dy, np.diff(pose[:, 2])], axis=-1)
        D, turned = np.diff(d, axis=0), d[:-1, 2]
        by = np.empty_like(D)
        by[:, 0] = c[:, None] * D[:, 0] + s[:, None] * D[:, 1] + step[:, 1, None] * turned
        by[:, 1] = -s[:, None] * D[:, 0] + c[:, None] * D[:, 1] - step[:, 0, None] * turned
        by[:, 2] = D[:, 2]
        return Motion(step, by)

    def noise(self, t: Float[np.ndarray, " n"], lag: float, cfg: MotionNoise) -> Float[np.ndarray, "m 3 3"]:
        """Covariances (n - 1, 3, 3) of `between`, in commanded units: no scale that is estimated can shrink them."""
        way, angle, known = (
            np.diff(self._integral(f, t - lag)) for f in (np.abs(self.v), np.abs(self.w), np.ones(len(self.t)))
        )
        dt = np.diff(t)
        lost = np.maximum(dt - known, 0.0)
        turn = cfg.drift**2 * way + cfg.turn**2 * angle + MOTION_REST_THETA**2 * dt + MOTION_LOST_THETA**2 * lost
        free = MOTION_REST_XY**2 * dt + MOTION_LOST_XY**2 * lost
        Q = np.zeros((len(dt), 3, 3))
        Q[:, 0, 0] = cfg.along**2 * way + free
        Q[:, 1, 1] = cfg.across**2 * way + free + way**2 / 3 * turn
        Q[:, 1, 2] = Q[:, 2, 1] = way / 2 * turn
        Q[:, 2, 2] = turn
        return Q

    def _row(self, t: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which command was the last, for how long [s] it had run, and 1 while it still does."""
        k = np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)
        since = t - self.t[k]
        return k, np.clip(since, 0.0, self.dt[k]), ((since >= 0.0) & (since < self.dt[k])).astype(float)

    def _integral(self, f: Float[np.ndarray, " r"], t: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        k, part, _ = self._row(t)
        return np.asarray(_before(f * self.dt)[k] + f[k] * part)


def random_walk(t: Float[np.ndarray, " n"], keeps: Float[np.ndarray, " m"] | None = None) -> Float[np.ndarray, "m 3 3"]:
    """Covariances (n - 1, 3, 3) of the motion of a robot whose commands nobody knows: it may stand or drive.

    keeps: (n - 1,) [s] for how long it may keep its speed and turn rate, where that is longer than a step: steps that
    are independent would bring it less far than driving on.
    """
    dt = np.diff(t)
    together = dt * (dt if keeps is None else np.maximum(keeps, dt))
    Q = np.zeros((len(dt), 3, 3))
    Q[:, 0, 0] = UNKNOWN_SPEED**2 * together + MOTION_REST_XY**2 * dt
    Q[:, 1, 1] = UNKNOWN_SLIP**2 * together + MOTION_REST_XY**2 * dt
    Q[:, 2, 2] = UNKNOWN_SPIN**2 * together + MOTION_REST_THETA**2 * dt
    return Q


def _before(steps: Float[np.ndarray, "r ..."]) -> Float[np.ndarray, "r ..."]:
    """The sum of all steps before each."""
    out = np.zeros_like(steps)
    np.cumsum(steps[:-1], axis=0, out=out[1:])
    return out


def _arc(
    v: Float[np.ndarray, " r"],
    w: Float[np.ndarray, " r"],
    dt: Float[np.ndarray, " r"],
    heading: Float[np.ndarray, " r"],
    heading_by_turn: Float[np.ndarray, " r"],
    turn: float,
) -> tuple[Float[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
    """The chord of each arc at unit speed scale, and its derivative by the turn scale."""
    half = 0.5 * turn * w * dt
    small = np.abs(half) < 1e-4
    safe = np.where(small, 1.0, half)
    sinc = np.where(small, 1 - half**2 / 6, np.sin(safe) / safe)
    slope = np.where(small, -half / 3, (np.cos(safe) - np.sin(safe) / safe) / safe)
    middle = heading + half
    c, s = np.cos(middle), np.sin(middle)
    way, turning = v * dt, heading_by_turn + 0.5 * w * dt
    chord = np.stack([way * sinc * c, way * sinc * s], axis=-1)
    bent = way * slope * 0.5 * w * dt
    by_turn = np.stack([bent * c - way * sinc * s * turning, bent * s + way * sinc * c * turning], axis=-1)
    return chord, by_turn


PARAMETERS = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
SPEED, TURN, LAG, BIAS, RANGE = range(len(PARAMETERS))


@dataclass(frozen=True, slots=True)
class Instants:
    """t: (n,) [s] ascending; start: (n, 3) poses to begin with, in the map's frame; track: where those come from.

    gap: (n - 1,) [s] between the instants before and after each step at which the robot saw or was seen; infinite where
    the robot was put down elsewhere in between.
    """

    t: Float[np.ndarray, " n"]
    start: Float[np.ndarray, "n 3"]
    track: Track
    gap: Float[np.ndarray, " m"]

    @property
    def steps(self) -> Int[np.ndarray, " s"]:
        """The instants from which the robot drove to the next."""
        return np.flatnonzero(np.isfinite(self.gap))

    def nearest(self, t: Float[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
        """Which instant is nearest to each of `t`."""
        right = np.clip(np.searchsorted(self.t, t), 1, max(len(self.t) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(self.t) - 1)
        return np.asarray(np.where(t - self.t[left] <= self.t[right] - t, left, right))

    def from_nearest(self, t: Float[np.ndarray, " m"]) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"]]:
        """The instant nearest to each of `t`, and the small motion `T_instant_t` from there, as `track` has it."""
        k = self.nearest(t)
        return k, se2.between(self.start[k], se2.interpolate(t, self.track.t, self.track.pose))


def instants_of(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], track: Track, cfg: SmoothingConfig) -> Instants:
    """The instants of `log`'s robot: first and last stamp of every stretch, sightings it made, sightings of it."""
    stretches = _of_stretches(log, seen_at, cfg)
    t = np.concatenate([stamps for stamps, _ in stretches])
    gap = np.concatenate([np.append(steps, np.inf) for _, steps in stretches])[:-1]
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, gap)


def count_instants(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig) -> int:
    """How many `instants_of` gives."""
    kept = [_kept(stretch, seen_at, cfg) for stretch in log.stretches() if len(stretch)]
    return sum(1 + int(_parts(np.diff(t), cfg).sum()) for t in kept)


def _of_stretches(
    log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig
) -> list[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]:
    return [_of_stretch(stretch, seen_at, cfg) for stretch in log.stretches() if len(stretch)]


def _of_stretch(
    log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    return _with_steps(_kept(log, seen_at, cfg), cfg)


def _kept(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig) -> Float[np.ndarray, " k"]:
    """The first and last stamp of a stretch and those at which it saw or was seen, of near ones the first."""
    first, last = log.span
    inside = seen_at[(seen_at >= first) & (seen_at <= last)]
    t = np.unique(np.concatenate([[first, last], log.sightings.t, log.bearings.t, inside]))
    return _spaced(t, cfg.shortest_step)


def instants_between(
    first: float, last: float, seen: Float[np.ndarray, " s"], track: Track, cfg: SmoothingConfig
) -> Instants:
    """The instants of a stretch of a log: `first` and `last` [s], both kept, and where it saw or was seen between."""
    t = _spaced(np.unique(np.concatenate([[first], seen[(seen > first) & (seen < last)]])), cfg.shortest_step)
    if last > first:
        t = np.append(t[: max(1, int(np.searchsorted(t, last - cfg.shortest_step, side="right")))], last)
    t, gap = _with_steps(t, cfg)
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, gap)


def _with_steps(
    t: Float[np.ndarray, " k"], cfg: SmoothingConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """`t` and so many stamps between that no step is longer than the longest; and the gap each step lies in."""
    gaps = np.diff(t)
    parts = _parts(gaps, cfg)
    more = [np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(t[:-1], t[1:], parts, strict=True) if n > 1]
    return np.sort(np.concatenate([t, *more])), np.repeat(gaps, parts)


def _parts(gaps: Float[np.ndarray, " g"], cfg: SmoothingConfig) -> Int[np.ndarray, " g"]:
    """In how many steps each gap is driven, so that none is longer than the longest."""
    return np.asarray(np.maximum(np.ceil(gaps / cfg.longest_step - 1e-9).astype(int), 1))


def keyframe_instants(t: Float[np.ndarray, " n"], track: Track) -> Instants:
    """The instants of a robot whose scans became keyframes at `t`: between them its scans tell the motion well."""
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, np.diff(t))


def _spaced(t: Float[np.ndarray, " n"], least: float) -> Float[np.ndarray, " k"]:
    """Of stamps nearer than `least` to the one kept before, none."""
    kept = [t[0]]
    for value in t[1:].tolist():
        if value - kept[-1] >= least:
            kept.append(value)
    return np.array(kept)


@dataclass(frozen=True, slots=True)
class RobotPart:
    """What one robot brings: its log, when its pose is estimated, and where that stands among the variables.

    start: entry of its first pose; parameters: entry of its first calibration parameter; motion: None without odometry;
    scans: its keyframes, which are its instants then, or None without a laser.
    """

    log: LandmarkLog
    instants: Instants
    start: int
    parameters: int
    motion: CommandedMotion | None
    scans: RobotGraph | None = None

    @property
    def seen(self) -> SightingTable:
        """All it saw, with and without a range (NaN there)."""
        return all_seen(self.log)

    @property
    def robot(self) -> str:
        return self.log.robot

    def pose_columns(self, k: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
        """The entries of x that hold the poses at the instants `k`."""
        return np.asarray(self.start + 3 * k[:, None] + np.arange(3))


def all_seen(log: LandmarkLog) -> SightingTable:
    """The sightings with a range and, after them, those by bearing alone."""
    with_range, without = log.sightings, log.bearings
    if not len(without):
        return with_range
    if not len(with_range):
        return without
    what = np.concatenate([with_range.what, without.what + len(with_range.ids)])
    t, z, b = (
        np.concatenate([getattr(with_range, name), getattr(without, name)]) for name in ("t", "range", "bearing")
    )
    return SightingTable(t, what, z, b, (*with_range.ids, *without.ids))
