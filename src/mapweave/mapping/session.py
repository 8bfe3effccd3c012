"""One robot's laser estimator fed event by event: what a finished log and a robot that drives now have in common.

What every scan did to the estimate is kept while a log goes on: some 120 bytes a scan.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Event, Scan, frozen
from ..core.run import Runner
from ..core.workers import Progress, no_progress
from ..kernels._jit import set_threads
from ..laser import icp_slam, particle_slam
from ..laser.config import GEOMETRY, Feature, weighed
from ..laser.icp_slam import IcpState
from ..laser.keyframes import KeyframeOdometry
from ..laser.laser_map import ScanInfos
from ..laser.moving import MovingReturns
from ..laser.particle_slam import ParticleState
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import PoseEstimate, ScanInfo
from ..laser.sweep import swept
from . import graph_slam
from .config import LaserConfig
from .graph_slam import GraphState

NO_RANGES, NO_HITS = frozen(np.zeros(0)), frozen(np.zeros(0), np.bool_)
LET_GO = Scan(NO_RANGES, NO_HITS, None, 0.0, 0.0, 1.0)
"""Stands for a scan that no map needs."""


class _Begun:
    """An estimator module whose `init` already knows the feature: what `mapweave.core.run` takes."""

    def __init__(self, module: Any, feature: Feature, *, gated: bool) -> None:
        self.module, self.feature, self.gated = module, feature, gated

    def init(self, robot: str, cfg: Any, rng: np.random.Generator) -> Any:
        f = self.feature
        return self.module.init(robot, cfg, rng, feature=f.name, calibration=f.calibration, gated=self.gated)

    def step(self, state: Any, event: Event, cfg: Any, rng: np.random.Generator) -> tuple[Any, Any]:
        after: tuple[Any, Any] = self.module.step(state, event, cfg, rng)
        return after


def estimator(cfg: LaserConfig, feature: Feature) -> _Begun:
    """The estimator of `cfg.method` with `init` and `step`, to be run by `mapweave.core.run`."""
    icp = cfg.method == "icp" or (cfg.method == "gated" and cfg.matcher == "icp")
    module = graph_slam if cfg.method == "graph" else icp_slam if icp else particle_slam
    return _Begun(module, feature, gated=cfg.method == "gated")


class Finalised(NamedTuple):
    """poses: (m, 3) at every scan; graph: keyframes and closures in the same frame, None of the other methods."""

    poses: Float[np.ndarray, "m 3"]
    graph: RobotGraph | None


class LaserSession:
    """The estimate of one robot while its scans come. `push` changes it; everything else leaves it as it is.

    Poses are in the frame of the first scan. infos: what became of every scan; scans: each without the returns of
    things that move, which `moving` counts, and `LET_GO` where the graph does without it. sweep: [s] from a scan's
    first beam to its last, as `sweep_of` finds it; 0: scans are of one moment. One session belongs to one thread.
    """

    def __init__(
        self, robot: str, cfg: LaserConfig, seed: int = 0, feature: Feature = GEOMETRY, sweep: float = 0.0
    ) -> None:
        set_threads(cfg.threads if cfg.method in {"particle", "graph"} else 1)
        cfg = weighed(cfg, feature)
        self.robot, self.cfg, self.feature, self.sweep = robot, cfg, feature, sweep
        self.infos = ScanInfos()
        self.scans: list[Scan] = []
        self.moving = MovingReturns(cfg.moving)
        self._last = self._motion = np.zeros(3)
        self._t = -np.inf
        self._odometry: Float[np.ndarray, 3] | None = None
        self._heading: float | None = None
        self._runner = Runner(estimator(cfg, feature), cfg, seed)

    def push(self, event: Event) -> ScanInfo | None:
        """What a scan did to the estimate; None of odometry packets."""
        record = event.record
        if not isinstance(record, Scan):
            self._runner.push(event)
            return None
        predicted = self._predicted(record)
        scan = self.moving.cleaned(event.t, record, predicted) if self.cfg.moving.leave_out else record
        scan = swept(scan, se2.between(self._last, predicted), event.t - self._t, self.sweep)
        self._t = event.t
        info: ScanInfo = self._runner.push(replace(event, record=scan)).info
        self.scans.append(scan)
        self.infos.append(info)
        for row in self.unneeded:
            self.scans[row] = LET_GO
        local = self._local()
        self._motion, self._last = se2.between(self._last, local), local
        self._odometry, self._heading = record.odometry, record.heading
        self.moving.correct(local)
        return info

    def _predicted(self, scan: Scan) -> Float[np.ndarray, "3"]:
        """Where the front end will be at the scan as wheels have it; without wheels it goes on as before."""
        motion = self._motion
        if scan.odometry is not None:
            motion = np.zeros(3) if self._odometry is None else se2.between(self._odometry, scan.odometry)
        elif scan.heading is not None and self._heading is not None:
            motion = np.array([*motion[:2], scan.heading - self._heading])
        return np.asarray(se2.compose(self._last, motion))

    def _local(self) -> Float[np.ndarray, "3"]:
        """The latest pose of the front end, which drifts and never jumps."""
        state = self._state()
        if isinstance(state, GraphState):
            state = state.odometry if state.particles is None else state.particles
        if isinstance(state, IcpState):
            return np.array(state.poses[-1])
        return np.array(state.local if isinstance(state, KeyframeOdometry) else state.odometry.pose)

    def cleaned(self, scans: Sequence[Scan]) -> tuple[Scan, ...]:
        """The scans that were pushed, in that order, as the map is made of them: some have no ranges any more."""
        return tuple(
            replace(theirs, ranges=NO_RANGES, hit=NO_HITS, intensities=None) if own is LET_GO else own
            for own, theirs in zip(self.scans, scans, strict=True)
        )

    @property
    def unneeded(self) -> range:
        """The scans whose ranges no map will need, as of the last push: their places are known well."""
        state = self._state()
        return state.unneeded if isinstance(state, GraphState) else range(0)

    @property
    def now(self) -> PoseEstimate:
        """The latest pose and its covariance; of `icp`, which tells none, a covariance of NaN."""
        state = self._state()
        if isinstance(state, GraphState):
            return graph_slam.current(state)
        if isinstance(state, ParticleState):
            return particle_slam.current(state)
        if isinstance(state, IcpState) and state.poses:
            return PoseEstimate(np.array(state.poses[-1]), np.full((3, 3), np.nan))
        return PoseEstimate(np.zeros(3), np.zeros((3, 3)))

    def graph(self, *, covariances: bool = True) -> RobotGraph | None:
        """The keyframes so far, solved, with their returns; None before the first, and of other methods than graph.

        Without `covariances`, which take most of the time, they are NaN.
        """
        state = self._state()
        if not isinstance(state, GraphState) or not len(state.t):
            return None
        return graph_slam.so_far(state, self.cfg, covariances=covariances)

    def finalise(self, on_progress: Progress = no_progress) -> Finalised:
        """The best that all scans so far tell; there is one at least."""
        state = self._state()
        if isinstance(state, GraphState):
            return Finalised(*graph_slam.finalise(state, self.cfg, on_progress))
        if isinstance(state, IcpState):
            return Finalised(np.array(state.poses), None)
        return Finalised(particle_slam.trajectory(state), None)

    def _state(self) -> Any:
        return self._runner.states.get(self.robot)
