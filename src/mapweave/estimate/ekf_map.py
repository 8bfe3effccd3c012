"""One robot's log becomes its local map: all of it through EKF-SLAM, and what there is to say about the result."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.errors import EstimateError
from ..core.records import Track
from ..kernels import ekf
from ..maps.local_map import LocalMap, RobotSightings
from ..maps.submap import Submap
from ..readers.landmark_log import LandmarkLog, SightingTable
from . import ekf_slam
from .ekf_config import EkfSlamConfig, calibration_prior, noise

CALIBRATION = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
ENOUGH = 20  # sightings from which a landmark that keeps contradicting itself is told
CONTRADICTED = 0.5  # share of its sightings that were down-weighted
MUCH_DOWN_WEIGHTED = 0.3
HIGH_NIS = 3.0


@dataclass(frozen=True, slots=True)
class _Replay:
    """A log played to its end: state, map, track, and each landmark sighting's slot, NIS and weight."""

    ids: tuple[str, ...]
    x: Float[np.ndarray, " m"]
    P: Float[np.ndarray, "m m"]
    started: Bool[np.ndarray, " k"]
    submap: Submap
    track: Track
    slots: Int[np.ndarray, " n"]
    nis: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


def local_map(log: LandmarkLog, cfg: EkfSlamConfig | None = None, seed: int = 0) -> LocalMap:  # noqa: ARG001
    """The map of `log` in `local_K`; raises EstimateError when the filter leaves finite numbers.

    A name that keeps contradicting itself has no fixed place: it is left out and told, an unlisted barcode as
    misreads. Nothing is random here; `seed` is what every estimator takes.
    """
    cfg = config_for(log, cfg or EkfSlamConfig())
    seen = log.sightings
    done = _replay(log, seen, cfg)
    restless = _restless(done)
    dropped, warnings = dict(log.dropped), list(log.warnings)
    if restless:
        wanted = np.array([name not in restless for name in seen.ids], bool)
        gone = seen.counts()
        for name in sorted(restless):
            reason = "misread barcode" if name.startswith("barcode:") else "sighting: no fixed place"
            dropped[reason] = dropped.get(reason, 0) + gone[name]
            warnings.append(f"{name} was seen {gone[name]} times but at no fixed place: left out")
        seen = seen.select(wanted[seen.what])
        done = _replay(log, seen, cfg)
    return _result(log, cfg, done, dropped, warnings)


def config_for(log: LandmarkLog, cfg: EkfSlamConfig) -> EkfSlamConfig:
    """`cfg` for this log: a robot without odometry walks at random."""
    return replace(cfg, odometry=False) if log.odometry is None else cfg


def _replay(log: LandmarkLog, seen: SightingTable, cfg: EkfSlamConfig) -> _Replay:
    used, first = np.unique(seen.what, return_index=True)
    order = used[np.argsort(first)]  # slots in the order of first sighting, as stepping gives them
    order = np.array([k for k in order if ekf_slam.is_landmark(seen.ids[k])], dtype=np.int64)
    slot = np.full(len(seen.ids), -1, np.int64)
    slot[order] = np.arange(len(order))
    slots, ids, n = slot[seen.what], tuple(seen.ids[k] for k in order), len(order)
    size = ekf.HEAD + 2 * n
    x, P = np.zeros(size), np.zeros((size, size))
    x[ekf.POSE : ekf.HEAD], sd = calibration_prior(cfg)
    P[range(ekf.POSE, ekf.HEAD), range(ekf.POSE, ekf.HEAD)] = sd**2
    Phi, Q = np.zeros((ekf.POSE, ekf.HEAD)), np.zeros((ekf.POSE, ekf.POSE))
    ekf.clear(Phi, Q)
    odometry = log.odometry
    commands = [np.zeros(0)] * 3 if odometry is None else [odometry.t, odometry.v, odometry.w]
    started, waiting, n_waiting = np.zeros(n, bool), np.zeros((n, ekf.CANDIDATES, 2)), np.zeros(n, np.int64)
    nis, weight = np.empty(len(seen)), np.empty(len(seen))
    most = len(commands[0]) + len(seen)
    t, pose, cov = np.empty(most), np.empty((most, ekf.POSE)), np.empty((most, 6))
    start = min(float(s[0]) for s in (commands[0], seen.t) if len(s)) if most else 0.0
    cmd_t, cmd_v, cmd_w = (np.array(c) for c in commands)
    stamp, distance, bearing = (np.array(c) for c in (seen.t, seen.range, seen.bearing))
    rows = ekf.replay(
        x, P, Phi, Q, start, cmd_t, cmd_v, cmd_w, stamp, slots, distance, bearing,
        noise(cfg), started, waiting, n_waiting, nis, weight, t, pose, cov,
    )  # fmt: skip
    ekf.settle(P, size, Phi, Q)
    if not (np.isfinite(x).all() and np.isfinite(P).all()):
        raise EstimateError(f"{log.source}: {log.robot}: EKF-SLAM left finite numbers")
    frame = f"local_{log.number}"
    made = ekf_slam.submap(log.robot, frame, x, P, ids, started)
    pose[:rows, :2] *= x[ekf.RANGE_SCALE]
    track = Track(t[:rows], pose[:rows], ekf_slam.square(cov[:rows]), frame)
    return _Replay(ids, x, P, started, made, track, slots, nis, weight)


def _restless(done: _Replay) -> set[str]:
    """Started landmarks most of whose sightings were down-weighted."""
    out = set()
    for k in np.flatnonzero(done.started):
        weight = done.weight[done.slots == k]
        weight = weight[np.isfinite(weight)]
        if len(weight) >= ENOUGH and (weight < 1.0).mean() > CONTRADICTED:
            out.add(done.ids[int(k)])
    return out


def _result(
    log: LandmarkLog,
    cfg: EkfSlamConfig,
    done: _Replay,
    dropped: dict[str, int],
    warnings: list[str],
) -> LocalMap:
    counts = {done.ids[k]: int((done.slots == k).sum()) for k in np.flatnonzero(done.started)}
    unconfirmed = int((done.slots >= 0).sum()) - sum(counts.values())
    if unconfirmed:
        dropped["sighting: landmark not confirmed"] = unconfirmed
    judged = np.isfinite(done.nis)
    nis_median = float(np.median(done.nis[judged])) if judged.any() else None
    down = int((done.weight[judged] < 1.0).sum())
    if judged.any() and down > MUCH_DOWN_WEIGHTED * judged.sum():
        warnings.append(f"{down} of {int(judged.sum())} sightings had to be down-weighted: its map may be wrong")
    if nis_median is not None and nis_median > HIGH_NIS:
        warnings.append(f"sightings disagree with the filter: median NIS {nis_median:.1f}, expected about 1.4")
    table = log.sightings
    robots = np.array([not ekf_slam.is_landmark(name) for name in table.ids], bool)
    r = table.select(robots[table.what]) if len(table) else table
    others = RobotSightings(r.t, tuple(r.ids[k] for k in r.what), r.range, r.bearing)
    _, prior_sd = calibration_prior(cfg)
    sd = np.sqrt(np.maximum(np.diag(done.P)[ekf.POSE : ekf.HEAD], 0.0))
    calibration = {
        name: (float(done.x[ekf.POSE + k]), float(sd[k])) for k, name in enumerate(CALIBRATION) if prior_sd[k] > 0
    }
    return LocalMap(
        robot=log.robot,
        submap=done.submap,
        track=done.track,
        sightings=counts,
        robot_sightings=others,
        odometry="velocity" if cfg.odometry else "none",
        source=log.source,
        log_hash=log.log_hash,
        nis_median=nis_median,
        down_weighted=down,
        dropped=dropped,
        calibration=calibration,
        warnings=tuple(warnings),
    )
