"""Keyframes of the pose graph as one robot makes them, and every scan as it fits to one of them.

How far a keyframe's step may err follows from what the walls and the wheels tell together.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.gaussian import symmetrise
from ..core.records import Scan
from .beam import Beams
from .scan_matching import FrontEndConfig
from .scan_odometry import ScanInfo, ScanOdometry
from .wheel_worth import WheelWorth

STEP_NOISE_TRUST = 2.0  # [-] what one scan's information on its place counts, its returns not being independent
STEP_NOISE_BLUR = 0.02  # [-] share of the information across lines that noise in their normals feigns along them
STEP_NOISE_HOLD = 100.0  # [-] headings: how many scans' information a step counts, jitter not adding up


@config
class StepNoise:
    """How far a keyframe's step may err: what the lines of the scan and the wheels tell together, and drift.

    Squares grow with the distance driven. A scan's place is told by lines and wheels; its heading is held by long
    walls, so that what one scan errs does not add up: it is jitter, which every keyframe has once and no step inherits.
    """

    wheels_xy: float = 0.033  # [m per sqrt(m)] sd of odometry, whose scale errs for metres on end
    wheels_turn_per_m: float = 0.0075  # [rad per sqrt(m)] sd of odometry's heading with the distance
    wheels_turn: float = 0.018  # [rad per sqrt(rad)] and with the turning
    drift_xy: float = 0.002  # [m per sqrt(m)] that the front end drifts where walls tell all
    drift_turn: float = 0.0003  # [rad per sqrt(m)] that its heading drifts


def carried(cov: Float[np.ndarray, "3 3"], step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A pose's covariance in its own axes, carried to the pose `step` ahead: an error of heading moves that aside."""
    c, s = np.cos(step[2]), np.sin(step[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    J = R @ np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
    return np.asarray(J @ cov @ J.T)


def wheel_noise(step: Float[np.ndarray, "3"], noise: StepNoise) -> Float[np.ndarray, "3 3"]:
    """Covariance of one odometry increment."""
    d, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    xy = noise.wheels_xy**2 * d + 1e-8
    return np.diag([xy, xy, noise.wheels_turn_per_m**2 * d + noise.wheels_turn**2 * turn + 1e-8])


def believed(lines: Float[np.ndarray, "3 3"], trust: float, blur: float) -> Float[np.ndarray, "3 3"]:
    """Information of lines less what noise in their normals alone gives, positive semidefinite, times `trust`.

    Lines whose normals scatter by chance seem to tell something along themselves: `blur` times what they tell across.
    """
    scatter = 0.5 * blur * (lines[0, 0] + lines[1, 1])
    values, vectors = np.linalg.eigh(lines[:2, :2])
    kept = np.maximum(values - scatter, 0.0) / np.maximum(values, 1e-12)
    T = np.eye(3)
    T[:2, :2] = vectors @ np.diag(np.sqrt(kept)) @ vectors.T
    return symmetrise(trust * (T @ lines @ T))


def step_covariance(
    lines: Float[np.ndarray, "3 3"], wheels: Float[np.ndarray, "3 3"], way: float, noise: StepNoise
) -> Float[np.ndarray, "3 3"]:
    """Covariance of a keyframe's step over `way` [m], without the jitter of its ends."""
    place = believed(lines, STEP_NOISE_TRUST, STEP_NOISE_BLUR)[:2, :2] + np.linalg.inv(
        wheels[:2, :2] + 1e-10 * np.eye(2)
    )
    cov = np.zeros((3, 3))
    cov[:2, :2] = symmetrise(np.linalg.inv(place)) + (noise.drift_xy**2 * way + 1e-8) * np.eye(2)
    cov[2, 2] = 1.0 / (STEP_NOISE_HOLD * lines[2, 2] + 1.0 / (wheels[2, 2] + 1e-10)) + noise.drift_turn**2 * way + 1e-10
    return cov


class Keyframe(NamedTuple):
    """t [s]; local: (3,) pose in the robot's own frame; step: (3,) seen from its last keyframe (of the first: zero),
    cov: (3, 3) of it over x, y, theta of the keyframe's frame; path: [m] driven so far; beams: its returns; border: why
    nobody knows the step well, so that a new segment begins here, empty where it is known; wheels: (3,) the step as
    odometry alone tells it, None where it does not.
    """

    robot: int
    number: int  # among this robot's keyframes, from 0
    t: float
    local: Float[np.ndarray, "3"]
    step: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    path: float
    beams: Beams
    border: str = ""
    wheels: Float[np.ndarray, "3"] | None = None


class KeyframeScan(NamedTuple):
    """One scan. offset: (3,) pose in keyframe `number`; points: (n, 2) returns and ends: (m, 2) how far beams that
    did not come back are free, both [m] in the robot frame; light: (n, 2) feature and weight of the returns.
    """

    robot: int
    number: int
    t: float
    offset: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "m 2"]
    origin: Float[np.ndarray, "2"]  # of the sensor on the robot [m]
    light: Float[np.ndarray, "n 2"] | None = None  # None: all alike, no feature and weight 1


@config
class KeyframeConfig:
    """When a pose becomes a keyframe of the pose graph, and how far the step to it may err."""

    distance: float = 0.6  # [m] from the last keyframe, or
    turn: float = 1.0  # [rad]: a keyframe beyond either
    noise: StepNoise = StepNoise()


class KeyframeMaker:
    """Keyframes along one robot's path, each with the covariance of the step to it. `advance` and `keyframe` change it.

    robot: its number in the team; local: (3,) the latest pose in the robot's own frame; step: (3,) the latest motion;
    path: [m] driven; last: the latest keyframe; worth: what is known of its wheels, None: they are as any.
    """

    def __init__(self, robot: int, cfg: KeyframeConfig, worth: WheelWorth | None = None) -> None:
        self.robot, self.cfg, self.worth = robot, cfg, worth
        self.local, self.step, self.path = np.zeros(3), np.zeros(3), 0.0
        self.last: Keyframe | None = None
        self._lines = np.zeros((3, 3))  # information of the walls on the latest pose
        self._wheels = np.zeros((3, 3))  # covariance of odometry since the last keyframe, in the latest robot frame
        self._told: np.ndarray | None = np.zeros(3)  # what odometry tells since then

    def advance(
        self,
        pose: Float[np.ndarray, "3"],
        step: Float[np.ndarray, "3"],
        lines: Float[np.ndarray, "3 3"],
        told: Float[np.ndarray, "3"] | None = None,
    ) -> None:
        """The robot is at `pose` now, after `step`; lines: information of the walls on it, robot-frame x, y, theta.

        told: the step as odometry alone tells it, None where it does not.
        """
        self.local, self.step, self._lines = pose, step, lines
        self._wheels = carried(self._wheels, step) + wheel_noise(step, self.cfg.noise)
        self._told = None if told is None or self._told is None else np.asarray(se2.compose(self._told, told))
        self.path += float(np.hypot(step[0], step[1]))

    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of the latest pose seen from the last keyframe, over x, y, theta of the latest robot frame."""
        path = 0.0 if self.last is None else self.last.path
        wheels = self._wheels if self.worth is None else self.worth.scaled(self._wheels)
        return step_covariance(self._lines, wheels, self.path - path, self.cfg.noise)

    def keyframe(
        self, t: float, b: Beams, border: str = "", weak: Float[np.ndarray, "3 3"] | None = None
    ) -> Keyframe | None:
        """A keyframe at the latest pose when it is far enough from the last one, or a new segment begins with it.

        border: why it does, empty where it does not; weak: (3, 3) covariance that its step has besides.
        """
        if self.last is None:
            new = Keyframe(self.robot, 0, t, self.local, np.zeros(3), np.zeros((3, 3)), 0.0, b)
        else:
            step = se2.between(self.last.local, self.local)
            if not border and np.hypot(step[0], step[1]) < self.cfg.distance and abs(step[2]) < self.cfg.turn:
                return None
            cov = self.covariance() if weak is None else self.covariance() + weak
            new = Keyframe(self.robot, self.last.number + 1, t, self.local, step, cov, self.path, b, border, self._told)
        self.last = new
        self._wheels, self._told = np.zeros((3, 3)), np.zeros(3)
        return new


class KeyframeOdometry:
    """One robot's scan odometry that hands out keyframes. `advance` and `keyframe` change it.

    odometry: its trajectory; maker: its keyframes; status: what came of the last scan; worth: what is learned of its
    wheels, None: they are as any.
    """

    def __init__(
        self, robot: int, cfg: KeyframeConfig, front_end: FrontEndConfig, feature: str = "none", *, learn: bool = False
    ) -> None:
        self.worth = WheelWorth(lambda step: wheel_noise(step, cfg.noise)) if learn else None
        self.maker = KeyframeMaker(robot, cfg, self.worth)
        self.odometry = ScanOdometry(front_end, feature=feature, tell_lines=True, worth=self.worth)
        self.status = "none"

    @property
    def local(self) -> Float[np.ndarray, "3"]:
        """The latest pose in the robot's own frame."""
        return self.maker.local

    @property
    def step(self) -> Float[np.ndarray, "3"]:
        """How the robot moved between the last two scans."""
        return self.maker.step

    @property
    def last(self) -> Keyframe | None:
        """The latest keyframe."""
        return self.maker.last

    def predict(self, scan: Scan) -> Float[np.ndarray, "3"]:
        """Where odometry puts the robot at a scan, in its own frame; without odometry it goes on as before."""
        return np.asarray(se2.compose(self.local, self.odometry.increment(scan.odometry, scan.heading).u))

    def advance(self, scan: Scan, b: Beams, *, leapt: bool = False, t: float | None = None) -> ScanInfo:
        """`local` is the pose of this scan; one that shows nothing is carried by odometry, unless that `leapt`.

        t: when it was taken [s].
        """
        info = self.odometry.advance(scan, b, leapt=leapt, t=t)
        self.status = info.decision
        self.maker.advance(self.odometry.pose, self.odometry.step, self.odometry.lines, self.odometry.told)
        return info

    def keyframe(
        self, t: float, b: Beams, border: str = "", weak: Float[np.ndarray, "3 3"] | None = None
    ) -> Keyframe | None:
        """As of `KeyframeMaker`."""
        return self.maker.keyframe(t, b, border, weak)
