"""What graph mapping knows of one robot: keyframes with their returns, steps, closures; enough to go on or to merge.

Poses in places that its map knows well hang on keyframes and are none themselves.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.records import freeze, frozen
from .beam import IntensityCalibration
from .closures import Closure
from .pose_graph import PoseGraph


@dataclass(frozen=True, slots=True)
class Revisits:
    """v poses in the order of their stamps t (v,) [s].

    at: (v,) the keyframe each hangs on; step: (v, 3) its pose in that keyframe's frame; cov: (v, 3, 3) of the step over
    x, y, theta of the pose's own frame. closures: how many were given up with the keyframes that stood there.
    """

    t: Float[np.ndarray, " v"] = field(default_factory=lambda: np.zeros(0))
    at: Int[np.ndarray, " v"] = field(default_factory=lambda: np.zeros(0, np.int64))
    step: Float[np.ndarray, "v 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    cov: Float[np.ndarray, "v 3 3"] = field(default_factory=lambda: np.zeros((0, 3, 3)))
    closures: int = 0

    def __post_init__(self) -> None:
        freeze(self, "t", "step", "cov")
        freeze(self, "at", dtype=np.int64)

    def __len__(self) -> int:
        return len(self.t)

    def poses(self, keyframes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "v 3"]:
        """Where they are when the keyframes stand at these poses."""
        return np.asarray(se2.compose(keyframes[self.at], self.step))

    def covariances(
        self, keyframes: Float[np.ndarray, "n 3"], cov: Float[np.ndarray, "n 3 3"]
    ) -> Float[np.ndarray, "v 3 3"]:
        """Of the poses, over x, y, theta in the keyframes' frame: what the keyframe errs, its heading times the way
        to the pose with it, and what the step errs.
        """
        pose, base = self.poses(keyframes), keyframes[self.at]
        J = np.tile(np.eye(3), (len(self), 1, 1))
        J[:, 0, 2], J[:, 1, 2] = base[:, 1] - pose[:, 1], pose[:, 0] - base[:, 0]
        return np.asarray(J @ cov[self.at] @ J.swapaxes(1, 2) + se2.turned_covariance(pose[:, 2], self.cov))


@dataclass(frozen=True, slots=True)
class RobotGraph:
    """The n keyframes of one log in `local_k`, whose origin is the robot's first pose.

    t: (n,) stamps [s]; pose: (n, 3) as estimated in the end; cov: (n, 3, 3) of each, marginal of the pose graph over
    x, y, theta in `local_k`; path: (n,) [m] driven; step: (n - 1, 3) pose of keyframe i + 1 in keyframe i as scan
    odometry measured it, step_information: (n - 1, 3, 3) in the later one's frame; closures: every one tried, its
    `first` and `second` number these keyframes. border: of each why a new segment begins there, the step to it being
    known to nobody, empty where it is known. unclear: keyframes after a border, which fit elsewhere about as well.

    Returns of keyframe i are the rows start[i]:start[i + 1] (start: (n + 1,)) of points (m, 2) [m], normals (m, 2) and
    q (m,), in the keyframe's robot frame; q is None where light was not used. lined: (m,) where three or more beams
    made the normal; glass: (m,) those of panes, which only beams that meet them squarely show. sensor: (n, 2) where the
    scanner stood on the robot [m]. revisits: where the robot was in places known well, between these keyframes.
    """

    robot: str
    t: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    cov: Float[np.ndarray, "n 3 3"]
    path: Float[np.ndarray, " n"]
    step: Float[np.ndarray, "s 3"]
    step_information: Float[np.ndarray, "s 3 3"]
    closures: tuple[Closure, ...]
    start: Int[np.ndarray, " n1"]
    points: Float[np.ndarray, "m 2"]
    normals: Float[np.ndarray, "m 2"]
    q: Float[np.ndarray, " m"] | None
    lined: Bool[np.ndarray, " m"]
    sensor: Float[np.ndarray, "n 2"]
    feature: str = "none"
    calibration: IntensityCalibration | None = None
    source: str = ""
    log_hash: str = ""
    revisits: Revisits = field(default_factory=Revisits)
    border: tuple[str, ...] = ()
    unclear: tuple[int, ...] = ()
    glass: Bool[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0, np.bool_))

    def __post_init__(self) -> None:
        freeze(self, "t", "pose", "cov", "path", "step", "step_information", "points", "normals", "sensor", "q")
        if not self.border:
            object.__setattr__(self, "border", ("",) * len(self.t))
        freeze(self, "start", dtype=np.int64)
        freeze(self, "lined", dtype=np.bool_)
        glass = self.glass if len(self.glass) else np.zeros(len(self.points), np.bool_)
        object.__setattr__(self, "glass", frozen(glass, np.bool_))

    def __len__(self) -> int:
        return len(self.t)

    def rows(self, i: int) -> slice:
        """Where the returns of keyframe `i` stand."""
        return slice(int(self.start[i]), int(self.start[i + 1]))

    def panes(self, pose: Float[np.ndarray, "n 3"] | None = None) -> Float[np.ndarray, "g 2"]:
        """Where returns of glass lie [m], in the frame of the keyframes' own poses or of others."""
        owner = np.repeat(np.arange(len(self)), np.diff(self.start))[self.glass]
        return np.asarray(se2.act((self.pose if pose is None else pose)[owner], self.points[self.glass]))

    def stored(self) -> "RobotGraph":
        """The same graph with returns as exact as a file holds them, so that maps made from either are the same."""
        return replace(
            self,
            points=_thin(self.points),
            normals=_thin(self.normals),
            q=None if self.q is None else _thin(self.q),
        )

    def moved(self, shift: Float[np.ndarray, "3"]) -> "RobotGraph":
        """The same graph seen from a frame in which its own origin is `shift`."""
        cov = se2.turned_covariance(shift[2], self.cov)
        return replace(self, pose=np.asarray(se2.compose(shift, self.pose)), cov=cov)

    def way(self) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, "w 3"], Float[np.ndarray, "w 3 3"]]:
        """Stamps, poses and covariances of keyframes and revisits, in order of time."""
        t = np.concatenate([self.t, self.revisits.t])
        order = np.argsort(t, kind="stable")
        pose = np.concatenate([self.pose, self.revisits.poses(self.pose)])
        cov = np.concatenate([self.cov, self.revisits.covariances(self.pose, self.cov)])
        return t[order], pose[order], cov[order]

    def steps(self) -> PoseGraph:
        """The keyframes with the edges of scan odometry."""
        n = len(self)
        return PoseGraph(self.pose, np.arange(n - 1), np.arange(1, n), self.step, self.step_information)

    def accepted(self) -> PoseGraph:
        """The keyframes with the edges of the closures that were believed."""
        kept = [c for c in self.closures if c.accepted]
        return PoseGraph.of(
            self.pose, [(c.first, c.second) for c in kept], [c.measured for c in kept], [c.information for c in kept]
        )

    def graph(self) -> PoseGraph:
        """Steps and then the closures that were believed."""
        return self.steps().joined(self.accepted())


def _thin(values: np.ndarray) -> np.ndarray:
    """32-bit numbers again as 64-bit ones."""
    return values.astype(np.float32).astype(np.float64)
