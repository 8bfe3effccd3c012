"""Keyframes of the pose graph as one robot makes them, and every scan as it fits to one of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.records import Scan
from .beam import Beams
from .scan_matching import FrontEndConfig
from .scan_odometry import ScanInfo, ScanOdometry
from .step_noise import StepNoise, carried, step_covariance, wheel_noise


class Keyframe(NamedTuple):
    """t [s]; local: (3,) pose in the robot's own frame; step: (3,) seen from its last keyframe (of the first: zero),
    cov: (3, 3) of it over x, y, theta of the keyframe's frame; path: [m] driven so far; beams: its returns.
    """

    robot: int
    number: int  # among this robot's keyframes, from 0
    t: float
    local: Float[np.ndarray, "3"]
    step: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    path: float
    beams: Beams


class Sweep(NamedTuple):
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
    """Keyframes along one robot's way, each with the covariance of the step to it. `advance` and `keyframe` change it.

    robot: its number in the team; local: (3,) the latest pose in the robot's own frame; step: (3,) the latest motion;
    path: [m] driven; last: the latest keyframe.
    """

    def __init__(self, robot: int, cfg: KeyframeConfig) -> None:
        self.robot, self.cfg = robot, cfg
        self.local, self.step, self.path = np.zeros(3), np.zeros(3), 0.0
        self.last: Keyframe | None = None
        self._lines = np.zeros((3, 3))  # information of the walls on the latest pose
        self._wheels = np.zeros((3, 3))  # covariance of odometry since the last keyframe, in the latest robot frame

    def advance(
        self, pose: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"], lines: Float[np.ndarray, "3 3"]
    ) -> None:
        """The robot is at `pose` now, after `step`; lines: information of the walls on it, robot-frame x, y, theta."""
        self.local, self.step, self._lines = pose, step, lines
        self._wheels = carried(self._wheels, step) + wheel_noise(step, self.cfg.noise)
        self.path += float(np.hypot(step[0], step[1]))

    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of the latest pose seen from the last keyframe, over x, y, theta of the latest robot frame."""
        path = 0.0 if self.last is None else self.last.path
        return step_covariance(self._lines, self._wheels, self.path - path, self.cfg.noise)

    def keyframe(self, t: float, b: Beams) -> Keyframe | None:
        """A keyframe at the latest pose when it is far enough from the last one."""
        if self.last is None:
            new = Keyframe(self.robot, 0, t, self.local, np.zeros(3), np.zeros((3, 3)), 0.0, b)
        else:
            step = se2.between(self.last.local, self.local)
            if np.hypot(step[0], step[1]) < self.cfg.distance and abs(step[2]) < self.cfg.turn:
                return None
            new = Keyframe(self.robot, self.last.number + 1, t, self.local, step, self.covariance(), self.path, b)
        self.last = new
        self._wheels = np.zeros((3, 3))
        return new


class KeyframeOdometry:
    """One robot's scan odometry that hands out keyframes. `advance` and `keyframe` change it.

    odometry: its trajectory; maker: its keyframes; status: what came of the last scan.
    """

    def __init__(self, robot: int, cfg: KeyframeConfig, front_end: FrontEndConfig, feature: str = "none") -> None:
        self.maker = KeyframeMaker(robot, cfg)
        self.odometry = ScanOdometry(front_end, feature=feature, tell_lines=True)
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

    def predict(self, odometry: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"]:
        """Where odometry puts the robot now, in its own frame; without odometry it goes on as before."""
        return np.asarray(se2.compose(self.local, self.odometry.increment(odometry).u))

    def advance(self, scan: Scan, b: Beams) -> ScanInfo:
        """`local` is the pose of this scan; one that shows nothing is carried by odometry."""
        info = self.odometry.advance(scan, b)
        self.status = info.decision
        self.maker.advance(self.odometry.pose, self.odometry.step, self.odometry.lines)
        return info

    def keyframe(self, t: float, b: Beams) -> Keyframe | None:
        """A keyframe at the latest pose when it is far enough from the last one."""
        return self.maker.keyframe(t, b)
