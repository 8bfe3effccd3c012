"""One robot's own trajectory: scan against local map, step by step. It drifts and never jumps."""

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import symmetrise
from .beam import Beams
from .keyframes import Keyframe
from .scan_matching import FrontEnd, allowed_sd
from .team_config import LaserTeamConfig, StepNoise


class RobotTrack:
    """What robot `robot` knows by itself. `look` and `keyframe` change it: it belongs to one team.

    local: (3,) latest pose, the first being zero; looks: how many scans; status: what came of the last one.
    """

    def __init__(self, robot: int, cfg: LaserTeamConfig) -> None:
        self.robot, self.cfg = robot, cfg
        self.front_end = FrontEnd(cfg.front_end, cfg.front_end.bare_tangent)
        self.local = np.zeros(3)
        self.looks = 0
        self.path = 0.0
        self.status = "none"
        self.odometry: np.ndarray | None = None
        self.step = np.zeros(3)
        self.last: Keyframe | None = None
        self._told = np.zeros((3, 3))  # what the lines tell of the latest pose
        self._wheels = np.zeros((3, 3))  # covariance of odometry since the last keyframe, in the latest robot frame

    def predict(self, odometry: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"]:
        """Where odometry puts the robot now, in its own frame; without odometry it goes on as before."""
        return se2.compose(self.local, self._increment(odometry))

    def look(self, b: Beams, odometry: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "3"]:
        """The pose (3,) of this scan in the robot's own frame; a scan that shows nothing is carried by odometry."""
        u = self._increment(odometry)
        self.odometry = None if odometry is None else np.array(odometry, float)
        first = self.looks == 0
        predicted = np.zeros(3) if first else se2.compose(self.local, u)
        pose, self.status, self._told = predicted, "first" if first else "empty", np.zeros((3, 3))
        if not first and len(b.q) >= self.cfg.least_beams:
            found = self.front_end.match(b, predicted, allowed_sd(u, self.cfg.front_end))
            self.status = "odometry"
            if found.matches >= self.cfg.least_share * found.beams:
                pose, self.status = found.pose, "matched"
                self._told = self.front_end.information(b, pose)
        self.step = np.zeros(3) if first else se2.between(self.local, pose)
        self._wheels = carried(self._wheels, self.step) + wheel_noise(self.step, self.cfg.steps)
        self.path += float(np.hypot(self.step[0], self.step[1]))
        self.local = pose
        self.looks += 1
        if len(b.q) >= self.cfg.least_beams:
            self.front_end.insert(b, pose)
        return pose

    def keyframe(self, t: float, b: Beams) -> Keyframe | None:
        """A keyframe at the latest pose when it is far enough from the last one."""
        if self.last is None:
            made = Keyframe(self.robot, 0, t, self.local, np.zeros(3), np.zeros((3, 3)), 0.0, b)
        else:
            step = se2.between(self.last.local, self.local)
            if np.hypot(step[0], step[1]) < self.cfg.keyframe_distance and abs(step[2]) < self.cfg.keyframe_turn:
                return None
            cov = step_covariance(self._told, self._wheels, self.path - self.last.path, self.cfg.steps)
            made = Keyframe(self.robot, self.last.number + 1, t, self.local, step, cov, self.path, b)
        self.last = made
        self._wheels = np.zeros((3, 3))
        return made

    def _increment(self, odometry: np.ndarray | None) -> np.ndarray:
        if odometry is None:
            return self.step
        return np.zeros(3) if self.odometry is None else se2.between(self.odometry, odometry)


def carried(cov: Float[np.ndarray, "3 3"], step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A covariance in the frame before `step`, seen in the frame after it (a later pose errs by turns before)."""
    c, s = np.cos(step[2]), np.sin(step[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    J = R @ np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
    return np.asarray(J @ cov @ J.T)


def wheel_noise(step: Float[np.ndarray, "3"], n: StepNoise) -> Float[np.ndarray, "3 3"]:
    """Covariance of one odometry increment."""
    d, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    xy = n.wheels_xy**2 * d + 1e-8
    return np.diag([xy, xy, n.wheels_turn_per_m**2 * d + n.wheels_turn**2 * turn + 1e-8])


def believed(told: Float[np.ndarray, "3 3"], trust: float, blur: float) -> Float[np.ndarray, "3 3"]:
    """Information of lines less what noise in their normals alone gives, positive semidefinite, times `trust`.

    Lines whose normals scatter by chance seem to tell something along themselves: `blur` times what they tell across.
    """
    scatter = 0.5 * blur * (told[0, 0] + told[1, 1])
    values, vectors = np.linalg.eigh(told[:2, :2])
    kept = np.maximum(values - scatter, 0.0) / np.maximum(values, 1e-12)
    T = np.eye(3)
    T[:2, :2] = vectors @ np.diag(np.sqrt(kept)) @ vectors.T
    return symmetrise(trust * (T @ told @ T))


def step_covariance(
    told: Float[np.ndarray, "3 3"], wheels: Float[np.ndarray, "3 3"], way: float, n: StepNoise
) -> Float[np.ndarray, "3 3"]:
    """Covariance of a keyframe's step over `way` [m], without the jitter of its ends."""
    place = believed(told, n.trust, n.blur)[:2, :2] + np.linalg.inv(wheels[:2, :2] + 1e-10 * np.eye(2))
    cov = np.zeros((3, 3))
    cov[:2, :2] = symmetrise(np.linalg.inv(place)) + (n.drift_xy**2 * way + 1e-8) * np.eye(2)
    cov[2, 2] = 1.0 / (n.hold * told[2, 2] + 1.0 / (wheels[2, 2] + 1e-10)) + n.drift_turn**2 * way + 1e-10
    return cov
