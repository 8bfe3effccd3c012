"""Keyframes of the pose graph as one robot makes them, and every scan as it fits to one of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.records import Scan
from .beam import Beams
from .scan_matching import FrontEndConfig
from .scan_odometry import ScanOdometry
from .step_noise import StepNoise, carried, step_covariance, wheel_noise
from .trace import ScanInfo


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
    did not come back are free, both [m] in the robot frame.
    """

    robot: int
    number: int
    t: float
    offset: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "m 2"]
    origin: Float[np.ndarray, "2"]  # of the sensor on the robot [m]


@config
class KeyframeConfig:
    """When a pose becomes a keyframe of the pose graph, and how far the step to it may err."""

    distance: float = 0.6  # [m] from the last keyframe, or
    turn: float = 1.0  # [rad]: a keyframe beyond either
    noise: StepNoise = StepNoise()


class KeyframeOdometry:
    """One robot's scan odometry that hands out keyframes. `advance` and `keyframe` change it.

    robot: its number in the team; odometry: its trajectory; path: [m] driven; status: what came of the last
    scan; last: the latest keyframe.
    """

    def __init__(self, robot: int, cfg: KeyframeConfig, front_end: FrontEndConfig, feature: str = "none") -> None:
        self.robot, self.cfg = robot, cfg
        self.odometry = ScanOdometry(front_end, feature=feature, tell_lines=True)
        self.path = 0.0
        self.status = "none"
        self.last: Keyframe | None = None
        self._wheels = np.zeros((3, 3))  # covariance of odometry since the last keyframe, in the latest robot frame

    @property
    def local(self) -> Float[np.ndarray, "3"]:
        """The latest pose in the robot's own frame."""
        return self.odometry.pose

    @property
    def step(self) -> Float[np.ndarray, "3"]:
        """How the robot moved between the last two scans."""
        return self.odometry.step

    def predict(self, odometry: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"]:
        """Where odometry puts the robot now, in its own frame; without odometry it goes on as before."""
        return np.asarray(se2.compose(self.local, self.odometry.increment(odometry).u))

    def advance(self, scan: Scan, b: Beams) -> ScanInfo:
        """`local` is the pose of this scan; one that shows nothing is carried by odometry."""
        info = self.odometry.advance(scan, b)
        self.status = info.decision
        self._wheels = carried(self._wheels, self.step) + wheel_noise(self.step, self.cfg.noise)
        self.path += float(np.hypot(self.step[0], self.step[1]))
        return info

    def keyframe(self, t: float, b: Beams) -> Keyframe | None:
        """A keyframe at the latest pose when it is far enough from the last one."""
        if self.last is None:
            new = Keyframe(self.robot, 0, t, self.local, np.zeros(3), np.zeros((3, 3)), 0.0, b)
        else:
            step = se2.between(self.last.local, self.local)
            if np.hypot(step[0], step[1]) < self.cfg.distance and abs(step[2]) < self.cfg.turn:
                return None
            way = self.path - self.last.path
            cov = step_covariance(self.odometry.lines, self._wheels, way, self.cfg.noise)
            new = Keyframe(self.robot, self.last.number + 1, t, self.local, step, cov, self.path, b)
        self.last = new
        self._wheels = np.zeros((3, 3))
        return new
