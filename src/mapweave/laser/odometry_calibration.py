"""How wheels and scanner fit together, told by a log itself: scale, bias and clock of odometry, the scanner's mounting.

Between two scans the scanner moves as the wheels move the robot that carries it: `S = T^-1 W T`, T the scanner's
mounting, W the wheels' motion and S what the scans tell of it (the hand-eye relation; for wheels and a laser scanner
[Censi13], "Simultaneous calibration of odometry and sensor parameters for mobile robots"). Over short stretches whose
walls tell the motion this is one least-squares problem in the wheels' scales and biases, the lag between the two
clocks and the mounting. Scans are matched with the wheels as a first guess alone, so that where walls stand in a
direction the matched motion is the scanner's own; other directions are left out.

Wheels err for metres on end and neighbouring residuals are alike, so that standard errors come from whole blocks of
stretches, of several lengths, and not from residuals one by one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.config import config
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track, frozen
from .beam import BeamConfig, beams

WORTH_TURN_SCALE = 0.2  # share of a turn by which wheels must surely be off for the map to gain,
WORTH_TURN_PER_M = 0.1  # [rad/m] of bias,
WORTH_TURN_PER_S = 0.05  # [rad/s] of bias

ODOMETRY_CALIBRATION_SURE = 5.0  # standard errors that a value must be off by
ODOMETRY_CALIBRATION_HELD = 0.25  # [m] by which a scale of ways moves the longest way that no walls tell, or
ODOMETRY_CALIBRATION_SCALE = 0.15  # of the way, whatever the walls tell
ODOMETRY_CALIBRATION_LAG = 0.2  # [s] between the clocks,
LAG_WAY = 0.05  # [m] that a robot drives in the lag
ODOMETRY_CALIBRATION_PLACE = 0.05  # [m] by which the scanner stands elsewhere than the log says,
ODOMETRY_CALIBRATION_AHEAD = 0.15  # [m] ahead or behind of where a log says nothing: its poses are the scanner's then
ODOMETRY_CALIBRATION_YAW = 0.05  # [rad] by which it is turned

PARAMETERS = ("speed_scale", "turn_scale", "turn_per_m", "turn_per_s", "lag", "sensor_x", "sensor_y", "sensor_yaw")
SPEED, TURN, PER_M, PER_S, LAG, X, Y, YAW = range(8)
MOUNTING = [X, Y, YAW]
NOMINAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
WIDTH = np.array([0.3, 0.3, 0.1, 0.1, 1.0, 0.5, 0.5, 0.5])  # what a parameter may be off before anything is known
OBSERVED = 0.1  # of `WIDTH`: a standard error must be smaller for the log to tell the parameter

STRETCH, STRETCH_TURN, STRETCH_TIME = 0.4, 0.35, 4.0  # [m] driven, [rad] turned or [s] passed end a stretch
STIFF = 0.04  # share of the walls of both its ends that must tell a direction
LEAST_RETURNS = 20  # on walls, in a scan
LEAST = 20  # stretches that tell a turn, and half as many a place
AGREEING = 0.75  # share of the motions without which the wheels are those of another drive
SPEEDS = 1.5  # from the slow to the fast, that tell biases by the metre and by the second apart
UNIT, UNIT_SCANS, UNIT_WAY = 2.0, 10, 0.2  # factor that is a unit; [m] in so many scans that tell it
LAGS = 0.1 * np.arange(-20, 21)  # [s] from which the best is refined
TURNING, LEAST_TURNING = 0.1, 10  # [rad] of a stretch that tells a lag, and of how many
ROUNDS, JACOBIANS = 60, 3  # Gauss-Newton steps at most, and the first of them that linearise anew
FIRST_SCALES = np.array([[1e-4, 1e-3, 1e-3], [1e-5, 1e-4, 1e-3]])  # of places, of headings
BETWEEN_ROWS = 0.05  # of the time between rows of odometry, that a lag errs by: they are joined by straight lines
UNBIASED = 3  # steps with instruments
SMALL_STEP = 1e-2  # standard errors: the last step of either kind
NU = 3.0  # degrees of freedom of the residuals' Student's t
GROSS = 5.0  # scales of the residuals from which a match is taken for wrong: its motion must not be believed either
SMALL_TURN = 0.05  # [rad] of turn seen that may be noise
BLOCKS = (32, 16, 8)  # as many parts of the log, whose scatter tells standard errors
LEAST_BLOCKS = 8  # of the log, left out one after the other
DIFFERENCE = np.array([1e-4, 1e-4, 1e-5, 1e-5, 0.02, 1e-4, 1e-4, 1e-5])  # for derivatives
SYSTEMATIC = np.array([1e-3, 1e-3, 2e-4, 1e-4, 2e-3, 2e-3, 2e-3, 5e-4])  # that matching errs by, however long the log
SETTLED = np.array([0.01, 0.02, 0.01, 0.01, 0.03, 0.01, 0.01, 0.01])  # a change of each that no map shows


@config
class OdometryCalibrationConfig:
    """When what a log tells of its wheels and its scanner's mounting is used to map it, table `[laser.odometry]`.

    Scans hold a map where there are walls, whatever the wheels say: a scale or a bias is worth using where it moves
    the robot by `held` over the ways that walls do not tell, or where it is so large that scans are searched for in
    the wrong place.
    """

    apply: bool = True  # whether a log is mapped with what it tells


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """What wheels are worth, their calibration taken off: standard deviations that grow with the root of the way.

    place: [m per sqrt(m)] along the way; turn_per_m: [rad per sqrt(m)] and turn: [rad per sqrt(rad)] of the
    heading, with the way and with the turning; `*_sd`: their standard errors. Infinite where the log does not tell
    them. They hold over ways of up to `WINDOWS[-1]` metres: wheels whose errors are alike for metres on end are worth
    what they are over those metres.
    """

    place: float = np.inf
    turn_per_m: float = np.inf
    turn: float = np.inf
    place_sd: float = np.inf
    turn_per_m_sd: float = np.inf
    turn_sd: float = np.inf

    @property
    def observed(self) -> bool:
        """Whether the log tells it at all."""
        return bool(np.isfinite([self.place, self.turn_per_m, self.turn]).all())

    @property
    def good(self) -> bool:
        """Whether a robot whose scans tell nothing may go on by these wheels for tens of metres."""
        worth = np.array([self.place, self.turn_per_m, self.turn])
        return bool((worth <= GOOD).all())

    def covariance(self, step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """Over x, y, theta of a short motion `step` by the wheels [m, m, rad]."""
        way, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        place = self.place**2 * way + 1e-8
        return np.diag([place, place, self.turn_per_m**2 * way + self.turn**2 * turn + 1e-8])


USUAL = 2  # standard errors
LAG_TURNS_SD = 0.05  # [s] of a lag that turns alone tell
DIGITS = np.array([0.1, 0.05, 0.01])  # [s] of a lag: the fewest that are within one standard error
QUARTER = np.pi / 2
NOISE = ("place", "turn_per_m", "turn", "place_sd", "turn_per_m_sd", "turn_sd")
WINDOWS = (1.0, 2.0, 4.0, 8.0)  # [m] over which wheels are compared with scans
LEAST_WINDOWS = 10  # of one length
STRAIGHT = 0.8  # chord over way of a window that tells an error along the way
GOOD = np.array([0.06, 0.012, 0.07])  # [m/sqrt(m), rad/sqrt(m), rad/sqrt(rad)] of good wheels, at most


@dataclass(frozen=True, slots=True)
class OdometryCalibration:
    """What a log tells of its wheels and its scanner, against what it says of them.

    value, sd: (8,) in the order of `PARAMETERS`. `speed_scale`, `turn_scale`: by which ways and turns of the wheels are
    to be multiplied; `turn_per_m` [rad/m], `turn_per_s` [rad/s]: to be added to their turns; `lag` [s]: by which the
    scans' stamps are late; `sensor_x`, `sensor_y` [m], `sensor_yaw` [rad]: to be added to `T_robot_sensor`. observed:
    (8,) which of them this log tells: a robot that never turns tells no place of its scanner; the others are as the log
    says and their sd is infinite. applied: (8,) which of them the map was made with. noise: what the wheels are worth
    once all of it is taken off. speed: [m/s] it drives at, the median; unheld: [m] of the longest way along which no
    walls tell the motion; stretches: how many were compared.
    """

    value: Float[np.ndarray, "8"]
    sd: Float[np.ndarray, "8"]
    observed: Bool[np.ndarray, "8"]
    applied: Bool[np.ndarray, "8"]
    noise: WheelNoise
    speed: float
    unheld: float
    stretches: int

    def __post_init__(self) -> None:
        for name, kind in (("value", np.float64), ("sd", np.float64), ("observed", np.bool_), ("applied", np.bool_)):
            object.__setattr__(self, name, frozen(getattr(self, name), kind))

    def worth(self, *, stated: bool) -> Bool[np.ndarray, "8"]:
        """(8,) which are surely off, and by so much that the map gains. stated: whether the log says a mounting."""
        off = np.abs(self.value - NOMINAL)
        scale = min(ODOMETRY_CALIBRATION_SCALE, ODOMETRY_CALIBRATION_HELD / max(self.unheld, 1e-9))
        lag = max(ODOMETRY_CALIBRATION_LAG, LAG_WAY / max(self.speed, 1e-9))
        ahead = ODOMETRY_CALIBRATION_PLACE if stated else ODOMETRY_CALIBRATION_AHEAD
        least = np.array(
            [
                scale,
                WORTH_TURN_SCALE,
                WORTH_TURN_PER_M,
                WORTH_TURN_PER_S,
                lag,
                ahead,
                ODOMETRY_CALIBRATION_PLACE,
                ODOMETRY_CALIBRATION_YAW,
            ]
        )
        return np.asarray(self.observed & (off > ODOMETRY_CALIBRATION_SURE * self.sd) & (off >= least))

    def usual(self, mounting: Float[np.ndarray, "3"]) -> "OdometryCalibration":
        """With values of what is applied that are usual, where they are within `USUAL` standard errors of these.

        A scanner stands on the robot's origin or its middle line and looks ahead or a quarter turn to a side; a lag
        has no more digits than are known. mounting: as the log says.
        """
        away = np.zeros(8)
        at = mounting + self.value[MOUNTING]
        away[[X, Y]] = -at[:2]
        away[YAW] = QUARTER * round(float(at[2]) / QUARTER) - at[2]
        digits = DIGITS * np.round(self.value[LAG] / DIGITS) - self.value[LAG]
        away[LAG] = next((d for d in digits.tolist() if abs(d) <= self.sd[LAG]), 0.0)
        near = self.applied & (np.abs(away) <= USUAL * self.sd)
        return replace(self, value=np.where(near, self.value + away, self.value))

    def used(self) -> Float[np.ndarray, "8"]:
        """(8,) the values that are applied, the others as the log says."""
        return np.where(self.applied, self.value, NOMINAL)

    def row(self) -> dict[str, Any]:
        """As in `metrics.json`: name -> value, sd, observed, applied, and `wheels`; null for what is not known."""
        rows = zip(PARAMETERS, self.value, self.sd, self.observed, self.applied, strict=True)
        noise = self.noise
        known = {name: getattr(noise, name) if noise.observed else None for name in NOISE}
        return {
            **{
                name: {
                    "value": float(v),
                    "sd": float(sd) if seen else None,
                    "observed": bool(seen),
                    "applied": bool(used),
                }
                for name, v, sd, seen, used in rows
            },
            "wheels": {
                **{name: {"value": known[name], "sd": known[f"{name}_sd"]} for name in NOISE[:3]},
                "good": noise.good,
            },
        }

    def numbers(self) -> Float[np.ndarray, " n"]:
        """Everything in one row of finite numbers, from which `from_numbers` makes it again."""
        noise = [getattr(self.noise, name) for name in NOISE] if self.noise.observed else 6 * [-1.0]
        sd = np.where(self.observed, self.sd, -1.0)
        rest = [self.speed, self.unheld, float(self.stretches)]
        return np.concatenate([self.value, sd, self.observed, self.applied, noise, rest]).astype(float)

    @classmethod
    def from_numbers(cls, numbers: Float[np.ndarray, " n"]) -> "OdometryCalibration":
        """What `numbers` was made from."""
        value, sd, observed, applied = numbers[:32].reshape(4, 8)
        noise, (speed, unheld, stretches) = numbers[32:38].tolist(), numbers[38:].tolist()
        return cls(
            value,
            np.where(observed > 0, sd, np.inf),
            observed > 0,
            applied > 0,
            WheelNoise() if noise[0] < 0 else WheelNoise(*noise),
            speed,
            unheld,
            int(stretches),
        )

    def in_words(self) -> str:
        """What was applied, in one sentence; empty where nothing was."""
        said = [
            f"{words} {factor * self.value[k]:.{digits}f} +- {factor * self.sd[k]:.{digits}f}{unit}"
            for k, (words, factor, digits, unit) in enumerate(SHOWN)
            if self.applied[k]
        ]
        if not said:
            return ""
        return f"mapped with what scans and wheels tell of each other: {', '.join(said)}; say it in the log to be sure"


DEGREES = 180 / np.pi
SHOWN = (
    ("the wheels' ways times", 1.0, 4, ""),
    ("their turns times", 1.0, 4, ""),
    ("a bias of their turns of", DEGREES, 2, " degrees/m"),
    ("a bias of their turns of", DEGREES, 3, " degrees/s"),
    ("scans stamped late by", 1.0, 3, " s"),
    ("the scanner farther ahead by", 1.0, 3, " m"),
    ("the scanner farther left by", 1.0, 3, " m"),
    ("the scanner turned left by", DEGREES, 2, " degrees"),
)


class Stretches(NamedTuple):
    """Short motions as scans tell them: n of them, one after the other.

    first, last: (n,) the scans at their ends; seen: (n, 3) motion of the scanner; axes: (n, 2, 2), rows are two
    directions in the scanner's frame at `first`; used: (n, 3) whether walls tell the motion along either, and the turn.
    """

    first: Int[np.ndarray, " n"]
    last: Int[np.ndarray, " n"]
    seen: Float[np.ndarray, "n 3"]
    axes: Float[np.ndarray, "n 2 2"]
    used: Bool[np.ndarray, "n 3"]


class OdometryRows(NamedTuple):
    """Odometry and what it is compared with.

    scan_t: (m,) stamps of scans [s]; t: (n,) of odometry, strictly ascending, pose: (n, 3); mounting: (3,) of the
    scanner as the log says; sensor_t, sensor: where the scanner was, at the stamps that ascend.
    """

    scan_t: Float[np.ndarray, " m"]
    t: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    mounting: Float[np.ndarray, "3"]
    sensor_t: Float[np.ndarray, " k"]
    sensor: Float[np.ndarray, "k 3"]

    def moved(self, p: Float[np.ndarray, "8"]) -> Float[np.ndarray, "m 3"]:
        """The robot at each scan by these wheels and parameters; headings run on and are not wrapped."""
        dead = dead_reckoning(self.t, self.pose, p)
        return np.column_stack([np.interp(self.scan_t - p[LAG], self.t, dead[:, k]) for k in range(3)])


class SolverStart(NamedTuple):
    """p: (8,) to begin with; centre, width: (8,) what is thought of them before; free: (8,) which are looked for."""

    p: Float[np.ndarray, "8"]
    centre: Float[np.ndarray, "8"]
    width: Float[np.ndarray, "8"]
    free: Bool[np.ndarray, "8"]

    def without(self, k: int) -> "SolverStart":
        """The same, and parameter k is what it is thought to be."""
        free = self.free & (np.arange(8) != k)
        return self._replace(free=free, p=np.where(free, self.p, self.centre))


class OdometryFit(NamedTuple):
    """p: (8,); cov: (8, 8) by residuals one by one; score: (n, 8) of each stretch; mixing: (8, 8), by which the sum of
    scores changes p; told: (n, 8) how much each stretch says of each. Rows of what is not free are zero.
    """

    p: Float[np.ndarray, "8"]
    cov: Float[np.ndarray, "8 8"]
    mixing: Float[np.ndarray, "8 8"]
    score: Float[np.ndarray, "n 8"]
    told: Float[np.ndarray, "n 8"]


def calibrate_odometry(log: LaserLog, sensor: Float[np.ndarray, "m 3"], beam: BeamConfig) -> OdometryCalibration | None:
    """What the motion of the scanner, at `sensor` in any one frame at each scan, tells of wheels and mounting.

    None where there are no wheels, too little that tells of them, or wheels that tell of another drive. Nothing is
    `applied` yet.
    """
    if len(log.scans) < LEAST or log.scans[0].odometry is None:
        return None
    unit = wheels_unit(log, sensor)
    s = stretches(log, sensor, beam, unit)
    if s.used[:, 2].sum() < LEAST or s.used[:, :2].sum() < LEAST:
        return None
    wheels = _wheels(log, sensor)
    free = np.ones(8, dtype=bool)
    if len({scan.T_robot_sensor.tobytes() for scan in log.scans}) > 1:
        free[MOUNTING] = False
    if _turning(s).sum() < LEAST_TURNING:
        free[LAG] = False
    way = np.hypot(s.seen[:, 0], s.seen[:, 1])
    spent = log.scan_t[s.last] - log.scan_t[s.first]
    slow, fast = np.quantile(way[spent > 0] / spent[spent > 0], [0.1, 0.9]) if (spent > 0).any() else (0.0, 0.0)
    drives = (way > STRETCH / 4) & (spent > 0)
    if fast < SPEEDS * slow:
        free[PER_S] = False
    centre, width = _with(NOMINAL, SPEED, unit), _with(WIDTH, SPEED, unit * WIDTH[SPEED])
    start = SolverStart(_start(s, wheels, centre) if free[LAG] else centre, centre, width, free)
    start = _identified(s, wheels, start)
    while True:
        fit = _solve(s, wheels, start)
        sd = standard_errors(fit, start.free, float(np.median(np.diff(wheels.t))))
        if not (start.free & (sd >= OBSERVED * width)).any():
            break
        start = start.without(int(np.argmax(np.where(start.free, sd / width, 0.0))))
    free = start.free
    if not free.any() or _agreeing(s, wheels, fit.p) < AGREEING:
        return None
    return OdometryCalibration(
        value=fit.p,
        sd=sd,
        observed=free,
        applied=np.zeros(8, dtype=bool),
        noise=_noise(sensor, wheels, fit.p),
        speed=float(np.median(way[drives] / spent[drives])) if drives.any() else 0.0,
        unheld=_longest_unheld(s, way),
        stretches=len(way),
    )


def with_lag(found: OdometryCalibration | None, lag: float) -> OdometryCalibration:
    """`found` with the lag [s] that turns alone tell applied, by its own value where it has one; None: that lag alone.

    Of two values that are not of one lag neither is applied.
    """
    late = np.arange(8) == LAG
    if found is None:
        nothing = np.zeros(8, dtype=bool)
        found = OdometryCalibration(NOMINAL, np.full(8, np.inf), nothing, nothing, WheelNoise(), 0.0, 0.0, 0)
    if not found.observed[LAG]:
        value, sd = np.where(late, lag, found.value), np.where(late, LAG_TURNS_SD, found.sd)
        return replace(found, value=value, sd=sd, observed=found.observed | late, applied=found.applied | late)
    same = abs(found.value[LAG] - lag) <= USUAL * np.hypot(found.sd[LAG], LAG_TURNS_SD)
    return replace(found, applied=found.applied | (late & same))


def corrected(log: LaserLog, calibration: OdometryCalibration) -> LaserLog:
    """The log with what is applied: other wheels, stamps and mounting. Every stamp it had has odometry still.

    Scans that are late get the earlier stamps of their moments; the clock is that of odometry.
    """
    p = calibration.used()
    change = p[MOUNTING]
    scans = log.scans
    if change.any():
        scans = tuple(replace(scan, T_robot_sensor=frozen(scan.T_robot_sensor + change)) for scan in scans)
    if (p[:X] == NOMINAL[:X]).all():
        return replace(log, scans=scans)
    rows_t, rows = _rows(log)
    dead = dead_reckoning(rows_t, rows, p)
    scan_t = log.scan_t - p[LAG]
    at = _interpolated(scan_t, rows_t, dead)
    scans = tuple(replace(scan, odometry=frozen(pose)) for scan, pose in zip(scans, at, strict=True))
    t = rows_t if log.odometry is None else np.union1d(log.odometry.t, log.scan_t)
    return replace(log, scan_t=scan_t, scans=scans, odometry=Track(t, _interpolated(t, rows_t, dead), frame="odom"))


def is_stated(log: LaserLog) -> bool:
    """Whether the log says how far ahead its scanner stands: anywhere but level with the robot's origin."""
    return any(scan.T_robot_sensor[0] != 0.0 for scan in log.scans)


def sensor_poses(poses: Float[np.ndarray, "m 3"], scans: Sequence[Scan]) -> Float[np.ndarray, "m 3"]:
    """Where the scanner stood at each scan, from the robot's `poses`."""
    return np.asarray(se2.compose(poses, np.array([scan.T_robot_sensor for scan in scans])))


def dead_reckoning(
    t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"], p: Float[np.ndarray, "8"]
) -> Float[np.ndarray, "n 3"]:
    """The wheels' poses by the parameters `p`, from where they begin; headings run on and are not wrapped.

    t: (n,) ascending; pose: (n, 3) as odometry says. Biases count with the way ahead and with the time.
    """
    step = se2.between(pose[:-1], pose[1:])
    turn = p[TURN] * step[:, 2] + p[PER_M] * step[:, 0] + p[PER_S] * np.diff(t)
    heading = pose[0, 2] + np.concatenate([[0.0], np.cumsum(turn)])
    along = heading[:-1] + 0.5 * (turn - step[:, 2])
    x, y = p[SPEED] * step[:, 0], p[SPEED] * step[:, 1]
    c, s = np.cos(along), np.sin(along)
    return np.column_stack(
        [
            pose[0, 0] + np.concatenate([[0.0], np.cumsum(c * x - s * y)]),
            pose[0, 1] + np.concatenate([[0.0], np.cumsum(s * x + c * y)]),
            heading,
        ]
    )


def wheels_unit(log: LaserLog, sensor: Float[np.ndarray, "m 3"]) -> float:
    """How far scans move for a metre of the wheels, where that is so much that these have another unit; else 1."""
    wheels = np.array([scan.odometry for scan in log.scans], dtype=float)
    robot = se2.compose(sensor, se2.inverse(np.array([scan.T_robot_sensor for scan in log.scans])))
    by, seen = (np.hypot(*(at[UNIT_SCANS:, :2] - at[:-UNIT_SCANS, :2]).T) for at in (wheels, robot))
    moved = (seen > UNIT_WAY) & (by > 0)
    unit = float(np.median(seen[moved] / by[moved])) if moved.sum() >= LEAST else 1.0
    return unit if max(unit, 1.0 / unit) > UNIT else 1.0


def stretches(log: LaserLog, sensor: Float[np.ndarray, "m 3"], beam: BeamConfig, unit: float = 1.0) -> Stretches:
    """The log cut into stretches, one after the other, by way, turn and time. unit: [m] of the wheels' own."""
    wheels = np.array([scan.odometry for scan in log.scans], dtype=float)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(wheels[:, :2], axis=0).T))])
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(np.unwrap(wheels[:, 2]))))])
    progress = np.column_stack(
        [unit * way / STRETCH, turned / STRETCH_TURN, (log.scan_t - log.scan_t[0]) / STRETCH_TIME]
    )
    cuts = [0]
    for k, row in enumerate(progress):
        if (row - progress[cuts[-1]]).max() >= 1.0:
            cuts.append(k)
    walls = [_walls(log.scans[k], beam) for k in cuts]
    first, last = np.array(cuts[:-1], dtype=np.int64), np.array(cuts[1:], dtype=np.int64)
    seen = np.asarray(se2.between(sensor[first], sensor[last])).reshape(-1, 3)
    axes, used = np.zeros((len(first), 2, 2)), np.zeros((len(first), 3), dtype=bool)
    for k in range(len(first)):
        a, b = walls[k], walls[k + 1]
        if a is None or b is None:
            continue
        R = se2.rotation(float(seen[k, 2]))
        both = np.linalg.inv(np.linalg.inv(a) + np.linalg.inv(R @ b @ R.T))
        values, vectors = np.linalg.eigh(both)
        axes[k], used[k] = vectors.T, (*(values >= STIFF), True)
    return Stretches(first, last, seen, axes, used)


def _walls(scan: Scan, beam: BeamConfig) -> Float[np.ndarray, "2 2"] | None:
    """The mean of n n^T over the returns on walls, n their normals in the scanner's frame; None of too few."""
    b = beams(scan, "none", None, beam)
    n = b.normal[b.support >= 3] @ se2.rotation(float(scan.T_robot_sensor[2]))
    return n.T @ n / len(n) + 1e-9 * np.eye(2) if len(n) >= LEAST_RETURNS else None


def _rows(log: LaserLog) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Stamps, strictly ascending, and poses: the rows of odometry and those that scans bring, which count first."""
    t, pose = log.scan_t, np.array([scan.odometry for scan in log.scans], dtype=float)
    if log.odometry is not None:
        others = ~np.isin(log.odometry.t, t)
        t, pose = np.concatenate([log.odometry.t[others], t]), np.concatenate([log.odometry.pose[others], pose])
    order = np.argsort(t, kind="stable")
    t, pose = t[order], pose[order]
    last = np.append(np.diff(t) > 0, True)
    return t[last], pose[last]


def _wheels(log: LaserLog, sensor: Float[np.ndarray, "m 3"]) -> OdometryRows:
    after = np.append(np.diff(log.scan_t) > 0, True)
    mounting = np.array(log.scans[0].T_robot_sensor, dtype=float)
    return OdometryRows(log.scan_t, *_rows(log), mounting, log.scan_t[after], sensor[after])


def _interpolated(
    at: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "m 3"]:
    out = np.column_stack([np.interp(at, t, pose[:, k]) for k in range(3)])
    out[:, 2] = se2.wrap_angle(out[:, 2])
    return out


def _residuals(p: Float[np.ndarray, "8"], s: Stretches, wheels: OdometryRows) -> Float[np.ndarray, "n 3"]:
    """What scans tell less what wheels do: place along the two axes [m], and heading [rad]."""
    moved = wheels.moved(p)
    W = se2.between(moved[s.first], moved[s.last])
    T = wheels.mounting + p[MOUNTING]
    S = se2.compose(se2.compose(se2.inverse(T), W), T)  # the hand-eye relation
    place = np.einsum("nij,nj->ni", s.axes, s.seen[:, :2] - S[:, :2])
    return np.column_stack([place, se2.wrap_angle(s.seen[:, 2] - (moved[s.last, 2] - moved[s.first, 2]))])


def _turning(s: Stretches) -> Bool[np.ndarray, " n"]:
    """Which stretches tell a lag: there motions one after the other differ by more than noise."""
    return np.asarray(s.used[:, 2] & (np.abs(s.seen[:, 2]) > TURNING))


def _start(s: Stretches, wheels: OdometryRows, centre: Float[np.ndarray, "8"]) -> Float[np.ndarray, "8"]:
    """`centre` but for the lag, that of those tried where residuals are least on the median."""
    turning, costs = _turning(s), []
    for lag in LAGS.tolist():
        r = np.abs(_residuals(_with(centre, LAG, lag), s, wheels))
        places = np.concatenate([r[s.used[:, 0], 0], r[s.used[:, 1], 1]])
        costs.append(np.median(places) + np.median(r[turning, 2]))
    best = int(np.argmin(np.array(costs) + 1e-9 * np.abs(LAGS)))
    return _with(centre, LAG, float(LAGS[best]))


def _with(p: Float[np.ndarray, "8"], k: int, value: float) -> Float[np.ndarray, "8"]:
    out = np.array(p)
    out[k] = value
    return out


def _jacobian(
    p: Float[np.ndarray, "8"], s: Stretches, wheels: OdometryRows, free: Bool[np.ndarray, "8"]
) -> Float[np.ndarray, "n 3 8"]:
    """Derivatives of the residuals by the free parameters."""
    J = np.zeros((len(s.first), 3, 8))
    for k in np.flatnonzero(free).tolist():
        h = float(DIFFERENCE[k] * max(1.0, abs(p[k])))
        ahead, behind = (_residuals(_with(p, k, p[k] + d), s, wheels) for d in (h, -h))
        J[:, :, k] = (ahead - behind) / (2 * h)
    return J


def _instruments(
    p: Float[np.ndarray, "8"],
    s: Stretches,
    wheels: OdometryRows,
    free: Bool[np.ndarray, "8"],
    J: Float[np.ndarray, "n 3 8"],
) -> Float[np.ndarray, "n 3 8"]:
    """The derivatives `J` at `p` once more, all but the lag's along the motion that scans tell."""
    own = se2.compose(wheels.sensor, se2.inverse(wheels.mounting + p[MOUNTING]))
    there = np.concatenate([NOMINAL[:X], p[MOUNTING]])
    Z = _jacobian(there, s, wheels._replace(t=wheels.sensor_t, pose=own), free & (np.arange(8) != LAG))
    Z[:, :, LAG] = J[:, :, LAG]
    Z[:, :, [SPEED, PER_M]] /= p[SPEED]
    Z[:, :, TURN] /= p[TURN]
    return Z


def _identified(s: Stretches, wheels: OdometryRows, start: SolverStart) -> SolverStart:
    """Without the parameters of which the scans' motion says too little, the worst first, however the wheels err."""
    while start.free.any():
        rates, r = _rates_of(s), _residuals(start.p, s, wheels)
        place, turn = _scales_of(r, rates, s.used, *FIRST_SCALES)
        weight = _weights(r, rates, place, turn, s.used)
        Z = _instruments(start.p, s, wheels, start.free, _jacobian(start.p, s, wheels, start.free))
        on = np.flatnonzero(start.free)
        told = np.einsum("nka,nk,nkb->ab", Z[:, :, on], weight, Z[:, :, on]) + np.diag(start.width[on] ** -2.0)
        worst = np.sqrt(np.diag(np.linalg.inv(told))) / start.width[on]
        if worst.max() < OBSERVED:
            break
        start = start.without(int(on[np.argmax(worst)]))
    return start


def _rates_of(s: Stretches) -> Float[np.ndarray, "n 3"]:
    """Of each stretch what the squared scale of its residuals grows with."""
    way, turn = np.hypot(s.seen[:, 0], s.seen[:, 1]), np.abs(s.seen[:, 2])
    return np.column_stack([np.ones(len(way)), way, np.maximum(turn - SMALL_TURN, 0.0)])


def _scales_of(
    r: Float[np.ndarray, "n 3"],
    rates: Float[np.ndarray, "n 3"],
    used: Bool[np.ndarray, "n 3"],
    place: Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """What the squared scales of places and of headings grow by, better than `place` and `turn`."""
    place = _scales(r[:, :2], np.repeat(rates[:, None], 2, axis=1), place, used[:, :2])
    return place, _scales(r[:, 2], rates, turn, used[:, 2])


def _solve(s: Stretches, wheels: OdometryRows, start: SolverStart) -> OdometryFit:
    """The maximum of Student's t likelihood over the free parameters and the residuals' scales, by EM; then unbiased.

    The squared scale of places and of headings is c0 + c1 way + c2 turn each, c >= 0. A turn that may be noise does
    not count there: residuals that are weighed by themselves are biased.

    Least squares take the wheels' motion for exact. Their noise makes every factor come out too small, by some per cent
    where they are poor, and a robot that drives straight seem to tell of its turns. So the last steps, with the weights
    that were found, use the motion of the scans as instrument, which has no part in that noise.
    """
    rates, (place, turn) = _rates_of(s), FIRST_SCALES
    on = np.flatnonzero(start.free)
    prior = start.width[on] ** -2.0
    p, J = np.array(start.p), np.zeros((0, 3, 8))
    for k in range(ROUNDS):
        r = _residuals(p, s, wheels)
        if k < JACOBIANS:
            J = _jacobian(p, s, wheels, start.free)
        place, turn = _scales_of(r, rates, s.used, place, turn)
        weight = _weights(r, rates, place, turn, s.used)
        H = np.einsum("nka,nk,nkb->ab", J[:, :, on], weight, J[:, :, on]) + np.diag(prior)
        step = np.linalg.solve(H, _gradient(J[:, :, on], weight * r, prior, p[on] - start.centre[on]))
        p[on] -= step
        if k >= JACOBIANS and (np.abs(step) * np.sqrt(np.diag(H)) < SMALL_STEP).all():
            break
    weight = _weights(_residuals(p, s, wheels), rates, place, turn, s.used)
    J = _jacobian(p, s, wheels, start.free)
    Z = _instruments(p, s, wheels, start.free, J)
    A = np.einsum("nka,nk,nkb->ab", Z[:, :, on], weight, J[:, :, on]) + np.diag(prior)
    for _ in range(UNBIASED):
        r = _residuals(p, s, wheels)
        p[on] -= np.linalg.solve(A, _gradient(Z[:, :, on], weight * r, prior, p[on] - start.centre[on]))
    score = np.zeros((len(s.seen), 8))
    score[:, on] = np.einsum("nka,nk->na", Z[:, :, on], weight * _residuals(p, s, wheels))
    cov, mixing = np.zeros((2, 8, 8))
    said = np.einsum("nka,nk->na", Z * Z, weight)
    told = np.einsum("nka,nk,nkb->ab", Z[:, :, on], weight, Z[:, :, on]) + np.diag(prior)
    cov[np.ix_(on, on)], mixing[np.ix_(on, on)] = np.linalg.inv(told), np.linalg.inv(A)
    return OdometryFit(p, cov, mixing, score, said)


def _gradient(
    J: Float[np.ndarray, "n 3 k"],
    weighted: Float[np.ndarray, "n 3"],
    prior: Float[np.ndarray, " k"],
    off: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    return np.asarray(np.einsum("nka,nk->a", J, weighted) + prior * off)


def _weights(
    r: Float[np.ndarray, "n 3"],
    rates: Float[np.ndarray, "n 3"],
    place: Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3"],
    used: Bool[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    scale = np.column_stack([rates @ place, rates @ place, rates @ turn])
    return np.asarray((used & (r * r < GROSS**2 * scale)) / scale * (NU + 1) / (NU + r * r / scale))


def _scales(
    r: Float[np.ndarray, "..."], rates: Float[np.ndarray, "... 3"], before: Float[np.ndarray, "3"], used: np.ndarray
) -> Float[np.ndarray, "3"]:
    """Three EM steps on the rates of the squared scale of residuals that are Student's t."""
    from scipy.optimize import nnls  # noqa: PLC0415  (costs time that only a finished log needs)

    r2, A = (r * r)[used], rates[used]
    x = before
    for _ in range(3):
        v = A @ x
        y, _ = nnls(A / v[:, None], (NU + 1) / (NU + r2 / v) * r2 / v)
        x = np.maximum(y, 0.05 * x)
    return np.asarray(x)


def standard_errors(fit: OdometryFit, free: Bool[np.ndarray, "8"], spacing: float) -> Float[np.ndarray, "8"]:
    """(8,) from how the scores of blocks scatter, the largest of several lengths of block; infinite where not free.

    The sandwich with blocks as clusters, what few blocks tell widened to Student's t; no less than residuals one by
    one tell. spacing: [s] of the rows of odometry.
    """
    from scipy.stats import t as student  # noqa: PLC0415

    n = len(fit.score)
    most = _deviations(fit.cov)
    for count in (n, *(b for b in BLOCKS if 2 * b <= n)):
        blocks = np.array([part.sum(axis=0) for part in np.array_split(fit.score, count)])
        told = np.array([part.sum(axis=0) for part in np.array_split(fit.told, count)])
        speak = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)  # blocks that tell of each
        spread = fit.mixing @ (blocks.T @ blocks * count / (count - 1)) @ fit.mixing.T
        wider = student.ppf(0.99865, np.maximum(speak - 1.0, 2.0)) / 3.0
        most = np.maximum(most, _deviations(spread) * wider)
    systematic = _with(SYSTEMATIC, LAG, max(float(SYSTEMATIC[LAG]), BETWEEN_ROWS * spacing))
    return np.where(free, np.hypot(most, systematic), np.inf)


def _deviations(cov: Float[np.ndarray, "8 8"]) -> Float[np.ndarray, "8"]:
    """Infinite where rounding left less than nothing of a variance: nothing is known there."""
    variance = np.diag(cov)
    return np.sqrt(np.where(variance >= 0.0, variance, np.inf))


def _agreeing(s: Stretches, wheels: OdometryRows, p: Float[np.ndarray, "8"]) -> float:
    """The share of the stretches in which wheels with these parameters tell the motion that scans tell, by halves."""
    r = np.abs(_residuals(p, s, wheels)) * s.used
    way, turn = np.hypot(s.seen[:, 0], s.seen[:, 1]), np.abs(s.seen[:, 2])
    places = np.hypot(r[:, 0], r[:, 1])[way > STRETCH / 2] <= 0.5 * way[way > STRETCH / 2]
    turns = r[_turning(s), 2] <= 0.5 * turn[_turning(s)]
    return min(float(same.mean()) if len(same) else 1.0 for same in (places, turns))


def _longest_unheld(s: Stretches, way: Float[np.ndarray, " n"]) -> float:
    """[m] of the longest way along which no walls tell the motion."""
    ahead = s.seen[:, :2] / np.maximum(way, 1e-9)[:, None]
    along = np.abs(np.einsum("nij,nj->ni", s.axes, ahead))
    held = s.used[:, 2] & ~(~s.used[:, :2] & (along > 0.5)).any(axis=1)
    longest = run = 0.0
    for ok, d in zip(held.tolist(), way.tolist(), strict=True):
        run = 0.0 if ok else run + d
        longest = max(longest, run)
    return longest


def _noise(sensor: Float[np.ndarray, "m 3"], wheels: OdometryRows, p: Float[np.ndarray, "8"]) -> WheelNoise:
    """What wheels with the parameters `p` are worth against the scanner's poses, over windows of several lengths.

    Standard errors leave out one block of the log after the other (the jackknife).
    """
    moved = wheels.moved(p)
    robot = se2.compose(sensor, se2.inverse(wheels.mounting + p[MOUNTING]))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(moved[:, :2], axis=0).T))])
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(moved[:, 2])))])
    windows = []
    for length in WINDOWS:
        at = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], length)))
        a, b = at[:-1], at[1:]
        if len(a) < LEAST_WINDOWS:
            break
        by, seen = se2.between(moved[a], moved[b]), se2.between(robot[a], robot[b])
        far, driven = np.hypot(by[:, 0], by[:, 1]), way[b] - way[a]
        off = ((seen - by)[:, :2] * by[:, :2]).sum(axis=1) / np.maximum(far, 1e-9)
        off[far < STRAIGHT * driven] = np.nan
        turn = se2.wrap_angle(seen[:, 2] - by[:, 2])
        windows.append(np.column_stack([off, turn, driven, turned[b] - turned[a], a * LEAST_BLOCKS // len(way)]))
    if not windows:
        return WheelNoise()
    whole = _rates(windows)
    parts = np.array([_rates([w[w[:, 4] != k] for w in windows]) for k in range(LEAST_BLOCKS)])
    sd = np.sqrt((LEAST_BLOCKS - 1) / LEAST_BLOCKS * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    return WheelNoise(*whole.tolist(), *sd.tolist())


def _rates(windows: Sequence[Float[np.ndarray, "_ 5"]]) -> Float[np.ndarray, "3"]:
    """`WheelNoise.place`, `turn_per_m` and `turn`: of the windows together, as large as the worst length needs it.

    windows: of each length, rows of error along the way (NaN where the way turns, whose heading errors would count
    twice), of heading, way, turned and block.
    """
    together = np.concatenate(windows)
    rates = np.column_stack([np.full(len(together), 1e-9), together[:, 2:4]])
    scale = _scales(together[:, 1], rates, np.array([1e-6, 1e-4, 1e-3]), np.ones(len(together), dtype=bool))[1:]
    place = max(_spread(w[:, 0] / np.sqrt(w[:, 2])) for w in windows)
    turn = max(_spread(w[:, 1] / np.sqrt(w[:, 2:4] @ scale)) for w in windows)
    return np.array([place, *(turn * np.sqrt(scale))])


def _spread(off: Float[np.ndarray, " n"]) -> float:
    """The standard deviation of what is normal but for outliers; 0 of less than a handful. NaN are left out."""
    there = np.abs(off[np.isfinite(off)])
    return float(1.4826 * np.median(there)) if len(there) >= LEAST_WINDOWS // 2 else 0.0
