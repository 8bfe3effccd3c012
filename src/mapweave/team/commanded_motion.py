"""Where commands say a robot went between any two instants, and how that changes with its calibration."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.records import Odometry
from .config import UNKNOWN_SLIP, UNKNOWN_SPEED, UNKNOWN_SPIN, MotionNoise

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
