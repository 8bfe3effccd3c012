"""A whole log through EKF-SLAM, and past poses corrected by the finished map."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..core.errors import EstimateError
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from ..core.run import Step, run
from ..kernels.landmarks import ekf_smooth
from ..kernels.landmarks.ekf import RANGE_SCALE, Commands, PoseRows, SightingRows
from . import ekf_slam
from .config import EkfSlamConfig, track_noise
from .landmark_map import Submap

MOST_NUMBERS = 30_000_000  # sightings times state: beyond, smoothing would take gigabytes and poses stay filtered

MOST_LANDMARKS = 5_000  # of one robot, whose covariance is kept dense, a few times over

LARGEST = 1e100  # [m], [m^2]: beyond, products of two numbers of the estimate are no longer finite


@dataclass(frozen=True, slots=True)
class FilterSnapshot:
    """The filter at one moment of its pass.

    state: None before the first row; tracked: how many poses there were by then; seen: how many sightings.
    """

    state: ekf_slam.EkfSlamState | None
    tracked: int
    seen: int


@dataclass(frozen=True, slots=True)
class ReplayedLog:
    """A log played to its end.

    x, P: the filter's last state; nis, weight: (n,) of each row of `seen`, NaN where it was no update of a landmark;
    taken: the filter at each of the times asked for; filtered: its poses before any was corrected, where times were.
    """

    seen: SightingTable
    x: Float[np.ndarray, " m"]
    P: Float[np.ndarray, "m m"]
    submap: Submap
    track: Track
    nis: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    findings: tuple[Finding, ...] = ()
    taken: tuple[FilterSnapshot, ...] = ()
    filtered: Track = ekf_slam.NOWHERE


def replay(log: LandmarkLog, cfg: EkfSlamConfig, seed: int = 0, times: Sequence[float] = ()) -> ReplayedLog:
    """EKF-SLAM over `log`, past poses corrected by the finished map; raises EstimateError when it overflows.

    times: [s] ascending, at which the filter's state is kept on its one pass.
    """
    failed = EstimateError(f"{log.source}: {log.robot}: EKF-SLAM left finite numbers")
    try:
        steps = list(run(ekf_slam, cfg, _that_may_start(log, cfg).events(times), seed))
    except ZeroDivisionError:  # an innovation's determinant ran over
        raise failed from None
    state = steps[-1].state if steps else ekf_slam.initial(log.robot, cfg)
    x, P = state.x, state.covariance()
    if not max(np.abs(x).max(), np.abs(P).max(initial=0.0)) < LARGEST:
        raise failed
    tracks = [step.info.track for step in steps]
    t, pose, square = (
        np.concatenate([getattr(ekf_slam.NOWHERE, name), *(getattr(track, name) for track in tracks)])
        for name in ("t", "pose", "cov")
    )
    filtered = Track(t.copy(), pose.copy(), square.copy(), state.frame) if len(times) else ekf_slam.NOWHERE
    if cfg.smooth and state.started.any() and len(log.sightings) * len(x) <= MOST_NUMBERS:
        _smooth(log, cfg, state, P, t, pose, square)
    if not (np.isfinite(pose).all() and np.isfinite(square).all()):
        raise failed
    scale = float(x[RANGE_SCALE])
    by = np.array([scale, scale, 1.0])
    track = Track(t, pose * by, square * np.outer(by, by), state.frame)
    nis, weight = (np.concatenate([np.zeros(0), *(getattr(s.info, name) for s in steps)]) for name in ("nis", "weight"))
    return ReplayedLog(
        log.sightings, x, P, state.submap, track, nis, weight, taken=_taken(steps, log, times), filtered=filtered
    )


def _that_may_start(log: LandmarkLog, cfg: EkfSlamConfig) -> LandmarkLog:
    """The log with names taken from what was sighted too rarely for a landmark: it takes no place in the filter.

    Raises EstimateError when more is left than a filter holds.
    """
    seen = log.sightings
    often = np.bincount(seen.what, minlength=len(seen.ids)) >= cfg.agree
    names = tuple(name if enough else "" for name, enough in zip(seen.ids, often, strict=True))
    n = sum(map(ekf_slam.is_landmark, names))
    if n > MOST_LANDMARKS:
        raise EstimateError(
            f"{log.source}: {log.robot}: {n} landmarks sighted {cfg.agree} times and oftener, at most "
            f"{MOST_LANDMARKS}: their covariance would take {8e-9 * (2 * n) ** 2:.1f} GB"
        )
    return replace(log, sightings=replace(seen, ids=names))


def _taken(steps: Sequence[Step], log: LandmarkLog, times: Sequence[float]) -> tuple[FilterSnapshot, ...]:
    """The filter at each of `times`, from the steps of a pass that was cut there."""
    ends = [step.t for step in steps]
    poses = np.cumsum([0, *(len(step.info.track.t) for step in steps)])
    out = []
    for t in times:
        k = int(np.searchsorted(ends, t, side="right"))
        seen = int(np.searchsorted(log.sightings.t, t, side="right"))
        out.append(FilterSnapshot(steps[k - 1].state if k else None, int(poses[k]), seen))
    return tuple(out)


def _smooth(
    log: LandmarkLog,
    cfg: EkfSlamConfig,
    state: ekf_slam.EkfSlamState,
    P: Float[np.ndarray, "m m"],
    t: Float[np.ndarray, " n"],
    pose: Float[np.ndarray, "n 3"],
    cov: Float[np.ndarray, "n 3 3"],
) -> None:
    """Poses and their covariances corrected, in place, by the finished map (`P`: its covariance, drive applied)."""
    seen, o = log.sightings, log.odometry
    slots = np.array([state.slot.get(name, -1) for name in seen.ids], dtype=np.int64)[seen.what]
    used = np.where((slots >= 0) & state.started[slots], slots, -1)
    commands = Commands(*(np.zeros((3, 0)) if o is None else np.stack([o.t, o.v, o.w])))
    sightings = SightingRows(*(np.array(c) for c in (seen.t, used, seen.range, seen.bearing)))
    nodes, track = np.unique(sightings.t), PoseRows(t, pose, cov)
    ekf_smooth.smooth(state.x, P, log.span[0], commands, sightings, nodes, track_noise(cfg), track)
