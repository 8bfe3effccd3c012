"""A laser log becomes a map: features chosen, estimator run, poses filled in at every stamp, grid laid.

Copies of one recording that were merged, and loggers that were held up and wrote all they had at once, give rows of
nearly one stamp and poses decimetres apart. Which of them was there at that time nobody can say; their middle is least
wrong.
"""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.errors import DataError
from ..core.laser_log import LaserLog
from ..core.records import Track
from ..core.workers import Progress, no_progress
from .beam import STEERING, IntensityCalibration, beams, calibrate, raw_scale
from .config import LaserConfig, MomentConfig
from .laser_map import LaserMap
from .log_warnings import jumps, lag_told, stamp_lag, unfound_places, wheels_disagree, wheels_stand
from .motion_agreement import instead_of, motion_agreement
from .occupancy_mapper import render
from .robot_graph import RobotGraph
from .scan_odometry import blended
from .session import Feature, LaserSession, ScanInfos

MANY = 20  # scans of which none has a return in reach are no accident


def choose_feature(log: LaserLog, cfg: LaserConfig) -> Feature:
    """The feature asked for where the log's intensity allows it, else `none` with a warning."""
    if cfg.feature == "none":
        return Feature("none", None)
    scans = [beams(scan, "raw", None, cfg.beam) for scan in log.scans] if log.has_intensity else []
    light = np.concatenate([b.intensity for b in scans]) if scans else np.zeros(0)
    if not len(light):
        return Feature("none", None, ("the log has no intensity: geometry alone is used",))
    if np.ptp(light) <= 1e-9 * float(np.abs(light).max()):
        return Feature("none", None, ("all intensities are equal: geometry alone is used",))
    if cfg.feature == "raw":
        return Feature("raw", raw_scale(scans))
    if log.scans[0].odometry is None:
        return Feature("raw", raw_scale(scans), ("no odometry to calibrate intensity with: it is used raw",))
    return _calibrated(calibrate(scans, np.array([scan.odometry for scan in log.scans]), cfg.calibration), cfg)


def _calibrated(calibration: IntensityCalibration | None, cfg: LaserConfig) -> Feature:
    if calibration is None:
        return Feature("none", None, ("no place was seen twice: intensity cannot be calibrated and is not used",))
    if calibration.residual > cfg.calibration.most_residual:
        reason = f"intensity does not follow range and incidence (residual {calibration.residual:.2f} in log units)"
        return Feature("none", calibration, (f"{reason}: geometry alone is used",))
    return Feature("normalised", calibration)


def hypotheses(cfg: LaserConfig, feature: Feature) -> int:
    """How many hypotheses the method of `cfg` carries at once in a log with this feature."""
    if cfg.method == "graph":
        return max(1, cfg.graph.hypotheses) if feature.name in STEERING else 1
    return cfg.particles if cfg.method == "particle" else 1


def finish(
    log: LaserLog,
    cfg: LaserConfig,
    feature: Feature,
    poses: Float[np.ndarray, "m 3"],
    infos: ScanInfos,
    graph: RobotGraph | None = None,
) -> LaserMap:
    """The result from the poses at every scan: poses at every stamp, the records, the grid. graph: in their frame."""
    frame = f"local_{log.robot}"
    track, dead, unclear = _tracks(log, poses, frame, cfg.moment)
    shift = se2.inverse(_first(log, poses))
    if graph is not None:
        graph = replace(graph.moved(shift), source=log.source, log_hash=log.log_hash)
        track = replace(track, cov=between_keyframes(track.t, graph))
    corrected = se2.compose(shift, poses)
    seen = [beams(scan, feature.name, feature.calibration, cfg.beam) for scan in log.scans]
    sensors = np.array([scan.T_robot_sensor for scan in log.scans])
    records = infos.records(log.scan_t, tuple(scan.host for scan in log.scans), corrected)
    return LaserMap(
        robot=log.robot,
        method=cfg.method,
        feature=feature.name,
        track=track,
        grid=render(seen, corrected, sensors, cfg.resolution, frame),
        scans=records,
        odometry=log.odometry_from,
        dead_reckoning=dead,
        calibration=feature.calibration,
        particles=hypotheses(cfg, feature),
        source=log.source,
        log_hash=log.log_hash,
        dropped=dict(log.dropped),
        warnings=(*log.warnings, *feature.warnings, *unclear),
        graph=graph,
        scan_hash=log.scan_hash(),
    )


def map_laser(
    log: LaserLog,
    cfg: LaserConfig,
    seed: int,
    on_progress: Progress = no_progress,
) -> LaserMap:
    """The map of one log, the same for the same seed."""
    cfg.check()
    if not len(log.scans):
        raise DataError(f"{log.source}: no scans")
    _check_reach(log, cfg)
    began = perf_counter()
    feature = choose_feature(log, cfg)
    calibrated = perf_counter()
    session = LaserSession(log.robot, cfg, seed, feature)
    for event in log.events():
        if session.push(event) is not None:
            on_progress(f"robot {log.robot}", len(session.infos), len(log.scans))
    spent = {"calibrate": calibrated - began, "estimate": perf_counter() - calibrated}
    return map_session(session, log, feature, spent, on_progress)


def _check_reach(log: LaserLog, cfg: LaserConfig) -> None:
    """Raises DataError where many scans have returns and none that can be used, as where ranges are in other units.

    A scanner whose beams never come back has an empty map, and its reader says so.
    """
    near, far = cfg.beam.least_range, cfg.beam.greatest_range
    if len(log.scans) < MANY or any(
        (scan.hit & (scan.ranges > near) & (scan.ranges < far)).any() for scan in log.scans
    ):
        return
    seen = np.concatenate([scan.ranges[scan.hit] for scan in log.scans])
    if len(seen):
        raise DataError(
            f"{log.source}: the median of the ranges is {np.median(seen):.4g}: expected returns between {near:g} and "
            f"{far:g} m; are the ranges in metres?"
        )


def map_session(
    session: LaserSession,
    log: LaserLog,
    feature: Feature,
    spent: Mapping[str, float],
    on_progress: Progress = no_progress,
) -> LaserMap:
    """The map of a session that was fed `log` whole. feature: the session's, and what there is to say about it.

    spent: seconds of its stages so far. Further scans may come to the session.
    """
    began = perf_counter()
    poses, graph = session.finalise(on_progress)
    finalised = perf_counter()
    clean = replace(log, scans=session.cleaned(log.scans))
    result = finish(clean, session.cfg, feature, poses, session.infos, graph)
    agreement = motion_agreement(result.scans.pose, clean.scans, session.cfg.beam, session.cfg.motion)
    motion_warnings = agreement.warnings(session.cfg.motion)
    lag = stamp_lag(log.scan_t, np.unwrap(result.scans.pose[:, 2]), log.odometry, session.cfg.lag)
    disagreement = (
        *lag_told(lag, session.cfg.lag),
        *jumps(result.scans, log.scans, session.cfg.jump),
        *wheels_disagree(result.track, result.dead_reckoning, session.cfg.wheels, agreement.factor(session.cfg.motion)),
        *wheels_stand(result.track, result.dead_reckoning, session.cfg.wheels),
    )
    moving_returns = {"return of something that moves": session.moving.count} if session.moving.count else {}
    left = {} if graph is None else left_graph(graph)
    unfound = () if graph is None else unfound_places(graph, session.cfg.graph.unfound)
    result = replace(
        result,
        scan_hash=log.scan_hash(),
        dropped={**result.dropped, **moving_returns, **left},
        warnings=(*instead_of(result.warnings, motion_warnings), *disagreement, *unfound),
    )
    timing = {
        **spent,
        **({} if graph is None else {"last_pass": finalised - began}),
        "grid": perf_counter() - finalised,
        "ms_per_scan": 1e3 * spent["estimate"] / len(log.scans),
    }
    return replace(result, timing=timing)


def left_graph(graph: RobotGraph) -> dict[str, int]:
    """What is not in the graph because the map knows its place well, counted; nothing where all is."""
    if not len(graph.revisits):
        return {}
    return {
        "keyframe in a place known well": len(graph.revisits),
        "closure of such a keyframe": graph.revisits.closures,
    }


def between_keyframes(t: Float[np.ndarray, " n"], graph: RobotGraph) -> Float[np.ndarray, "n 3 3"]:
    """Covariances at stamps `t`: those of the keyframes or revisits before and after, mixed by time."""
    at, _, cov = graph.way()
    after = np.clip(np.searchsorted(at, t, side="right"), 1, max(len(at) - 1, 1))
    after = np.minimum(after, len(at) - 1)
    before = np.maximum(after - 1, 0)
    span = np.maximum(at[after] - at[before], 1e-9)
    share = np.clip((t - at[before]) / span, 0.0, 1.0)[:, None, None]
    return np.asarray((1.0 - share) * cov[before] + share * cov[after])


def _first(log: LaserLog, poses: np.ndarray) -> np.ndarray:
    """The robot's pose at the log's first stamp, in the frame whose origin is the first scan."""
    rows = log.odometry
    if rows is None or log.scans[0].odometry is None or rows.t[0] >= log.scan_t[0]:
        return np.asarray(poses[0])
    return np.asarray(se2.compose(poses[0], se2.between(log.scans[0].odometry, rows.pose[0])))


def _tracks(
    log: LaserLog, poses: np.ndarray, frame: str, cfg: MomentConfig
) -> tuple[Track, Track | None, tuple[str, ...]]:
    """Estimate and dead reckoning at every odometry and scan stamp, from the first stamp's pose, and what to say."""
    shift = se2.inverse(_first(log, poses))
    rows = log.odometry
    if rows is None or log.scans[0].odometry is None:
        last = np.append(np.diff(log.scan_t) > 0, True)
        return Track(log.scan_t[last], se2.compose(shift, poses)[last], frame=frame), None, ()
    own = np.array([scan.odometry for scan in log.scans])
    between = ~np.isin(rows.t, log.scan_t)
    t = np.concatenate([rows.t[between], log.scan_t])
    order = np.argsort(t, kind="stable")
    odometry = np.concatenate([rows.pose[between], own])[order]
    at = np.flatnonzero(order >= int(between.sum()))
    filled = blended(odometry, at, se2.compose(shift, poses))
    t = t[order]
    filled, middle = of_one_moment(t, filled, order >= int(between.sum()), cfg)
    last = np.append(np.diff(t) > 0, True)
    dead = se2.between(odometry[0], odometry)
    tracks = Track(t[last], filled[last], frame=frame), Track(t[last], dead[last], frame="odom")
    if not middle.any():
        return *tracks, ()
    near = f"{int(middle.sum())} poses have stamps within {1e3 * cfg.within:g} ms of others and lie elsewhere"
    return *tracks, (f"{near}: stamps in the log are wrong; the trajectory gives the middle of such poses",)


def of_one_moment(
    t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"], scan: Bool[np.ndarray, " n"], cfg: MomentConfig
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The poses, those of one moment that contradict each other at their middle, and which these are.

    t: ascending [s]; scan: which poses are those of scans. The middle is the median over x, y and heading of the rows
    within `cfg.within`, seen from the row itself.
    """
    first = np.searchsorted(t, t - cfg.within, side="left")
    end = np.searchsorted(t, t + cfg.within, side="right")
    out, replaced = np.array(pose), np.zeros(len(t), dtype=bool)
    for k in np.flatnonzero(end - first > 1).tolist():
        rows = slice(first[k], end[k])
        seen = se2.between(pose[k], pose[rows])
        if (np.hypot(seen[:, 0], seen[:, 1]) <= cfg.apart).all() and (np.abs(seen[:, 2]) <= cfg.turned).all():
            continue
        middle = np.median(np.repeat(seen, np.where(scan[rows], cfg.scan_counts, 1), axis=0), axis=0)
        out[k], replaced[k] = se2.compose(pose[k], middle), True
    return out, replaced
