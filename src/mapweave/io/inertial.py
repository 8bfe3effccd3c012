"""What an inertial unit (IMU) tells of a robot on a floor: its turns, less a bias, and when it is tipped.

Turns are those about gravity, so that it does not matter how the unit is mounted. Whether they are turns in radians,
and in which sense, scans decide: of two scans the later one is the former turned by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.records import Scan, Track
from .scan_checks import range_difference

IMU = "sensor_msgs/msg/Imu"
GAP = 0.1  # [s] without a message, over which no turn is known
ASKEW = np.deg2rad(20.0)  # between gravity and where transforms put up, from which it is told
TIPPED, SLOW = np.deg2rad(25.0), 1.0  # [rad] from its usual direction, over so many [s] on average
SCALES = {
    1.0: "",
    -1.0: "the other way round",
    np.pi / 180: "in degrees",
    -np.pi / 180: "in degrees, the other way round",
}
TURN, AHEAD, LEAST = (0.08, 0.6), 20, 15  # [rad] between two scans that are compared, scans on, pairs
PAIRS = 400  # scans from which another is looked for, at most
CLEARLY = 0.1  # of the ranges' difference, that one turn must explain more than another
STILL, STANDS, STILL_TURN = 0.03, 1.0, 0.2  # [m] that ranges change by in [s] where a robot stands; [rad/s] at most
FEWEST = 3  # moments of standing that tell a bias


class Inertial(NamedTuple):
    """What one IMU said. rows: (n, 7) t [s], turn rates and accelerations over x, y, z of its frame, as they came.

    up: (3,) where transforms put up in its frame.
    """

    topic: str
    rows: Float[np.ndarray, "n 7"]
    up: Float[np.ndarray, "3"]


def imu_row(t: float, message: Any) -> tuple[float, ...]:
    """Time [s], turn rates and accelerations of a message; accelerations it says it has none of are NaN."""
    w, a = message.angular_velocity, message.linear_acceleration
    told = message.linear_acceleration_covariance[0] != -1
    return (t, w.x, w.y, w.z, *((a.x, a.y, a.z) if told else (np.nan,) * 3))


@dataclass(frozen=True, slots=True)
class Turns:
    """heading: (n,) [rad] about gravity at t [s], from any zero."""

    t: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"]
    findings: tuple[Finding, ...]

    def at(self, t: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """The heading at other times, NaN where it is not known."""
        out = np.interp(t, self.t, self.heading)
        row = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        known = (self.t[row] - self.t[row - 1] <= GAP) & (t >= self.t[0] - GAP) & (t <= self.t[-1] + GAP)
        return np.where(known, out, np.nan)

    def between(self, t: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
        """The turns from one of these times to the next, NaN over a gap."""
        gaps = np.concatenate([[0], np.cumsum(np.diff(self.t) > GAP)])
        row = np.clip(np.searchsorted(self.t, t), 0, len(self.t) - 1)
        return np.where(np.diff(gaps[row]) == 0, np.diff(self.at(t)), np.nan)


def turns_of(told: Inertial, robot: str) -> Turns | None:
    """The turns about gravity, and what is wrong with the unit or the robot; None where there are too few messages."""
    rows = told.rows[np.isfinite(told.rows[:, :4]).all(axis=1) & (np.abs(told.rows[:, 1:4]) < 1e4).all(axis=1)]
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]] if len(rows) else rows
    if len(rows) < LEAST:
        return None
    up, findings = told.up, []
    felt = rows[np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 4:]).max(axis=1) > 0), 4:]
    if len(felt) > 0.9 * len(rows):
        middle = np.median(felt, axis=0)
        gravity = middle / max(float(np.linalg.norm(middle)), 1e-9)
        off = float(np.arccos(np.clip(gravity @ up, -1.0, 1.0)))
        if off > ASKEW:
            findings.append(
                Finding("imu-mounted", robot, None, float(np.rad2deg(off)), "turns are taken about gravity")
            )
        up = gravity
        findings += _tipped(rows, gravity, robot)
    rate = rows[:, 1:4] @ up
    dt = np.diff(rows[:, 0])
    step = np.where(dt > GAP, 0.0, 0.5 * (rate[1:] + rate[:-1]) * dt)
    return Turns(rows[:, 0], np.concatenate([[0.0], np.cumsum(step)]), tuple(findings))


def _tipped(rows: Float[np.ndarray, "n 7"], up: Float[np.ndarray, "3"], robot: str) -> list[Finding]:
    """Where gravity points elsewhere than usual for longer than a jolt."""
    t = rows[:, 0]
    n = max(1, round(SLOW / max(float(np.median(np.diff(t))), 1e-3)))
    if n > len(t):
        return []
    felt = np.nan_to_num(rows[:, 4:])
    slow = np.stack([np.convolve(felt[:, k], np.full(n, 1.0 / n), mode="same") for k in range(3)], axis=-1)
    lean = np.arccos(np.clip(slow @ up / np.maximum(np.linalg.norm(slow, axis=1), 1e-9), -1.0, 1.0))
    edge = n // 2 + 1  # where the mean is of fewer
    over = np.flatnonzero(lean[edge:-edge] > TIPPED) + edge
    if not len(over):
        return []
    parts = np.split(over, np.flatnonzero(np.diff(t[over]) > SLOW) + 1)
    return [
        Finding("robot-tipped", robot, (float(t[p[0]]), float(t[p[-1]])), float(np.rad2deg(lean[p].max())))
        for p in parts
    ]


class Unit(NamedTuple):
    """What scans have shown of an IMU: one of `SCALES`, and its bias [rad/s]; None where they have not."""

    scale: float | None = None
    bias: float | None = None


class Turned(NamedTuple):
    """Scans and odometry with the turns of an IMU; why they are not used, empty where they are; what scans show."""

    scans: list[Scan]
    odometry: Track | None
    findings: list[Finding]
    unused: str
    unit: Unit = Unit()


def with_turns(
    told: Inertial,
    robot: str,
    t: Float[np.ndarray, " m"],
    scans: Sequence[Scan],
    odometry: Track | None,
    before: Unit = Unit(),  # noqa: B008  (it cannot be changed)
) -> Turned:
    """The scans, at `t` [s], and the odometry with the IMU's turns, where scans agree with these more than the wheels'.

    Without odometry each scan gets a heading; with it the odometry drives as far as it did, by the IMU's headings.
    before: what earlier scans have shown, which holds where these do not show it.
    """
    turns = turns_of(told, robot)
    if turns is None:
        return Turned(list(scans), odometry, [], "too few messages")
    found = list(turns.findings)
    agrees = {scale: _agreement(scans, scale * turns.at(t)) for scale in SCALES}
    best = max(agrees, key=lambda scale: agrees[scale])
    scale = before.scale or 1.0
    if best != scale and agrees[best] > max(0.0, agrees[scale]) + CLEARLY:
        scale = best
    elif -np.inf < agrees[scale] < 0.0:
        found.append(Finding("imu-unlike", robot, value=told.topic, action="they are not used"))
        return Turned(list(scans), odometry, found, "its turns are none that scans show", before)
    if scale != 1.0:
        found.append(Finding("imu-unit", robot, value=SCALES[scale], action="they are taken as such"))
    turns = replace(turns, heading=scale * turns.heading)
    bias = _bias(t, scans, turns.at(t))
    unit = Unit(scale if agrees[scale] > 0.0 else before.scale, before.bias if bias is None else bias)
    turns = replace(turns, heading=turns.heading - (unit.bias or 0.0) * (turns.t - turns.t[0]))
    if odometry is None:
        found.append(Finding("imu-turns", robot, value=f"{told.topic}: the robot has no wheels"))
        return Turned(_with_headings(scans, turns.between(t)), None, found, "", unit)
    wheels = np.unwrap([scan.odometry[2] for scan in scans])  # type: ignore[index]
    if not agrees[best] > _agreement(scans, wheels) + CLEARLY:
        return Turned(list(scans), odometry, found, "wheels tell turns as well")
    found.append(Finding("imu-turns", robot, value=f"{told.topic}: scans agree with them more than with the wheels'"))
    return Turned(list(scans), _driven(odometry, turns.between(odometry.t)), found, "")


def _agreement(scans: Sequence[Scan], heading: Float[np.ndarray, " m"]) -> float:
    """What share of the change of ranges between scans turns explain; minus infinity where too few turn."""
    still = turned = 0.0
    pairs = 0
    for k in range(0, len(scans) - 1, max(1, len(scans) // PAIRS)):
        turn = heading[k + 1 : k + 1 + AHEAD] - heading[k]
        far = np.flatnonzero(np.abs(turn) >= TURN[0])
        if not len(far) or abs(turn[far[0]]) > TURN[1]:
            continue
        a, b = scans[k], scans[k + 1 + int(far[0])]
        shift = round(turn[far[0]] / a.angle_increment)
        if not _alike(a, b) or not 2 <= abs(shift) <= len(a.ranges) // 2:
            continue
        before, after = range_difference(a, b, 0), range_difference(a, b, shift)
        if before is not None and after is not None:
            still, turned, pairs = still + before, turned + after, pairs + 1
    return (still - turned) / still if pairs >= LEAST and still > 0 else -np.inf


def _alike(a: Scan, b: Scan) -> bool:
    """Whether both are of one scanner, with the same beams."""
    return len(a.ranges) == len(b.ranges) and bool((a.T_robot_sensor == b.T_robot_sensor).all())


def _bias(t: Float[np.ndarray, " m"], scans: Sequence[Scan], heading: Float[np.ndarray, " m"]) -> float | None:
    """The turn rate [rad/s] that is told where scans show that the robot stands; None where it never does."""
    rates = []
    later = np.searchsorted(t, t + STANDS).tolist()
    for k in range(0, len(scans), max(1, len(scans) // PAIRS)):
        j = later[k]
        if j >= len(scans) or not _alike(scans[k], scans[j]):
            continue
        rate, change = (heading[j] - heading[k]) / (t[j] - t[k]), range_difference(scans[k], scans[j], 0)
        if change is not None and change < STILL and abs(rate) < STILL_TURN:
            rates.append(rate)
    return float(np.median(rates)) if len(rates) >= FEWEST else None


def _with_headings(scans: Sequence[Scan], step: Float[np.ndarray, " k"]) -> list[Scan]:
    """The scans with headings that differ by these turns; one after a turn that is not known has none."""
    heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(step))]).tolist()
    known = [True, *np.isfinite(step).tolist()]
    return [replace(scan, heading=a if k else None) for scan, a, k in zip(scans, heading, known, strict=True)]


def _driven(odometry: Track, turn: Float[np.ndarray, " k"]) -> Track:
    """As far as the odometry drove, with these turns from pose to pose; its own where they are not known."""
    step = se2.between(odometry.pose[:-1], odometry.pose[1:])
    turn = np.where(np.isfinite(turn), turn, step[:, 2])
    heading = odometry.pose[0, 2] + np.concatenate([[0.0], np.cumsum(turn)])
    way = np.hypot(step[:, 0], step[:, 1])  # the chord of an arc lies half its turn ahead
    along = np.arctan2(step[:, 1], step[:, 0]) + heading[:-1] + 0.5 * (turn - step[:, 2])
    xy = np.cumsum(way[:, None] * np.stack([np.cos(along), np.sin(along)], axis=-1), axis=0)
    xy = odometry.pose[0, :2] + np.concatenate([np.zeros((1, 2)), xy])
    return Track(odometry.t, np.column_stack([xy, se2.wrap_angle(heading)]), frame=odometry.frame)
