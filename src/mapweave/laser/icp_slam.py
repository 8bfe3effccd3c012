"""One hypothesis [Hara07]: Intensity-ICP against the last scan and the map, with or without the odometry gate."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Event, Scan
from .beam import Beams, IntensityCalibration, beams
from .config import FILTER_LEAST_BEAMS, LaserTrackingConfig
from .icp import match
from .particle_grid import ParticleGrid
from .particle_slam import as_points
from .scan_matching import allowed_sd
from .scan_odometry import ALONE_SD, NO_INNOVATION, ScanInfo, inside

ONE = np.zeros(1, np.int64)


@dataclass(slots=True)
class IcpState:
    """poses: one a scan, in `local_k`; last: the scan before as (x, y, q) in the map. `step` changes it in place."""

    maps: ParticleGrid
    feature: str
    calibration: IntensityCalibration | None
    gated: bool
    poses: list[np.ndarray] = field(default_factory=list)
    last: Float[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    odometry: np.ndarray | None = None
    motion: np.ndarray = field(default_factory=lambda: np.zeros(3))


def init(
    robot: str,  # noqa: ARG001  (every estimator is begun the same way)
    cfg: LaserTrackingConfig,
    rng: np.random.Generator,  # noqa: ARG001
    *,
    feature: str = "none",
    calibration: IntensityCalibration | None = None,
    gated: bool = False,
) -> IcpState:
    return IcpState(ParticleGrid(1, cfg.cells), feature, calibration, gated)


def step(
    state: IcpState,
    event: Event,
    cfg: LaserTrackingConfig,
    rng: np.random.Generator,  # noqa: ARG001
) -> tuple[IcpState, ScanInfo | None]:
    """Match, decide, insert. Odometry packets give no info: a scan brings its own odometry."""
    if not isinstance(event.record, Scan):
        return state, None
    scan = event.record
    b = beams(scan, state.feature, state.calibration, cfg.beam)
    u, sd = _increment(state, scan, cfg)
    if not state.poses:
        return _accept(state, b, np.zeros(3)), ScanInfo(NO_INNOVATION, len(b.q), 0, "first")
    predicted = np.asarray(se2.compose(state.poses[-1], u))
    if len(b.q) < FILTER_LEAST_BEAMS:
        state.poses.append(predicted)
        return state, ScanInfo(NO_INNOVATION, len(b.q), 0, "empty")
    reach = float(b.r.max()) + 0.5
    cells = state.maps.cells(0, predicted[:2], reach)[:, :3]
    matched = match(np.concatenate([state.last, cells]), np.column_stack([b.s, b.q]), predicted, cfg.icp)
    innovation = se2.between(predicted, matched.pose)
    accepted = matched.status != "failed"
    if accepted and state.gated and scan.odometry is not None:
        accepted = inside(innovation, cfg.eps(sd))
    _accept(state, b, matched.pose if accepted else predicted)
    return state, ScanInfo(innovation, len(b.q), matched.pairs, "matched" if accepted else "odometry")


def _increment(state: IcpState, scan: Scan, cfg: LaserTrackingConfig) -> tuple[np.ndarray, np.ndarray]:
    if scan.odometry is None:
        return state.motion, ALONE_SD
    u = np.zeros(3) if state.odometry is None else se2.between(state.odometry, scan.odometry)
    state.odometry = np.asarray(scan.odometry)
    return u, allowed_sd(u, cfg.front_end)


def _accept(state: IcpState, b: Beams, pose: np.ndarray) -> IcpState:
    if state.poses:
        state.motion = se2.between(state.poses[-1], pose)
    state.poses.append(pose)
    state.last = np.column_stack([se2.act(pose, b.s), b.q])
    state.maps.insert(ONE, pose[None], as_points(b), b.w.astype(np.float32))
    return state
