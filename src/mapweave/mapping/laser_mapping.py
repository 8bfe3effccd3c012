"""A laser log becomes a map: features chosen, estimator run, poses filled in at every stamp, grid laid.

Copies of one recording that were merged, and loggers that were held up and wrote all they had at once, give rows of
nearly one stamp and poses decimetres apart. Which of them was there at that time nobody can say; their middle is least
wrong.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.errors import DataError
from ..core.findings import Finding, of_robot
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track
from ..core.workers import Progress, no_progress
from ..laser.beam import CALIBRATION_WINDOW, MOST_RESIDUAL, STEERING, Beams, beams, calibrated, measured, raw_scale
from ..laser.config import Feature
from ..laser.laser_map import LaserMap, ScanInfos
from ..laser.light_worth import apart, worth
from ..laser.log_warnings import (
    clock_drift,
    jumps,
    lag_found,
    slides_alone,
    stamp_lag,
    turns_alone,
    wheels_disagree,
    wheels_leap,
    wheels_stand,
    wheels_unlike,
)
from ..laser.motion_agreement import GUESSED, instead_of, motion_agreement
from ..laser.occupancy_mapper import render
from ..laser.odometry_calibration import (
    NOMINAL,
    SETTLED,
    OdometryCalibration,
    calibrate_odometry,
    corrected,
    is_stated,
    sensor_poses,
    with_lag,
)
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import ScanOdometry, blended
from ..laser.sweep import sweep_of
from .config import LaserConfig
from .map_overlap import VIEWS, glass_returns, keyframe_map, seen_through
from .segments import LONG, bridged, cuts_disputed, held_over, segment_findings, set_down, way_bent, way_loose
from .session import LaserSession

MOMENT_WITHIN = 0.002  # [s] in which a robot hardly moves
MOMENT_APART = 0.02  # [m] by which such rows contradict each other
MOMENT_TURNED = 0.05  # [rad] by which the headings of such rows do
SCAN_COUNTS = 2  # rows of odometry that a scan's pose, which was matched, outweighs

FEW = 10  # scans: a log of fewer makes no map that could contradict itself
REMADE = 2  # times that a map is made anew at most, with what the one before tells of wheels and mounting
MANY = 20  # scans of which none has a return in reach are no accident


MOST_CALIBRATED = 4000  # scans from which light is calibrated: a longer log is asked in `STRETCHES` of them together
STRETCHES = 5  # of a long log
FAR_APART = 1e4  # [m] between the stretches, which share no place
THINNED = (0.05, 0.1)  # [m] and [rad] between scans that calibrate: what stands tells nothing of range
MOST_UNMEASURED = 0.2  # share of returns without light, from which it is not used


def choose_feature(log: LaserLog, cfg: LaserConfig) -> Feature:
    """The feature asked for where the log's intensity allows it, else `none` with a finding, once."""
    if cfg.feature == "none" or any(f.code == "light-unused" for f in log.findings):
        return Feature("none", None)
    returns = [beams(scan, "none", None, cfg.beam) for scan in log.scans] if log.has_intensity else []
    if why := _no_light(returns):
        return Feature("none", None, (Finding("light-unused", value=why),))
    if cfg.feature == "raw":
        return Feature("raw", raw_scale(returns))
    tried: list[Feature] = []
    for way in ways(log, returns, calibrating(len(log.scans)), cfg):
        tried.append(_calibrated(returns, way))
        if tried[-1].name != "none":
            return tried[-1]
    return tried[0]


def _no_light(returns: Sequence[Beams]) -> str:
    """Why the returns cannot tell anything by their light; empty where they might."""
    light = np.concatenate([b.intensity for b in returns]) if returns else np.zeros(0)
    with_light = measured(light)
    if not with_light.any():
        return "the log has none"
    if np.ptp(light[with_light]) <= 1e-9 * float(np.abs(light).max()):
        return "all are equal"
    without = 1.0 - float(with_light.mean())
    return f"{100 * without:.0f} % of the returns bear no light" if without > MOST_UNMEASURED else ""


def calibrating(m: int) -> list[range]:
    """The stretches of m scans from which light is calibrated."""
    if m <= MOST_CALIBRATED:
        return [range(m)]
    starts = np.linspace(0, m - MOST_CALIBRATED // STRETCHES, STRETCHES).astype(int)
    return [range(k, k + MOST_CALIBRATED // STRETCHES) for k in starts.tolist()]


def ways(
    log: LaserLog, returns: Sequence[Beams], stretches: Sequence[range], cfg: LaserConfig
) -> Iterator[tuple[list[int], Float[np.ndarray, "k 3"]]]:
    """Scans and poses of them that are right over a few metres: of wheels, and of scans matched on geometry alone."""
    wheels = log.scans[0].odometry is not None
    for matched in (False, True) if wheels else (True,):
        rows: list[int] = []
        poses: list[np.ndarray] = []
        for number, stretch in enumerate(stretches):
            if matched:
                front = ScanOdometry(cfg.front_end)
                for k in stretch:
                    front.advance(log.scans[k], returns[k], t=float(log.scan_t[k]))
                way = np.array(front.poses.array)
            else:
                way = np.array([log.scans[k].odometry for k in stretch], float)
            kept = apart(way, 0, len(way), *THINNED)
            rows += [stretch[k] for k in kept]
            poses.append(way[kept] + np.array([number * FAR_APART, 0.0, 0.0]))
        yield rows, np.concatenate(poses)


def _calibrated(returns: Sequence[Beams], way: tuple[list[int], Float[np.ndarray, "k 3"]]) -> Feature:
    """Light as it is along a way, and `none` with the reason where it tells nothing."""
    rows, poses = way
    scans = [returns[k] for k in rows]
    found = calibrated(scans, poses)
    if found is None:
        return Feature("none", None, (Finding("light-unused", value="no place was seen twice to calibrate it"),))
    calibration = found.whole
    if calibration.residual > MOST_RESIDUAL:
        why = f"it does not follow range and incidence (residual {calibration.residual:.2f} in log units)"
        return Feature("none", calibration, (Finding("light-unused", value=why),))
    told = worth(scans, poses, found.halves, CALIBRATION_WINDOW)
    calibration = replace(calibration, information=told.information)
    if told.information <= 0:
        return Feature("none", calibration, (Finding("light-unused", value=told.why),))
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
    track, dead, unclear = _tracks(log, poses, frame)
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
        grid=render(seen, corrected, sensors, cfg.resolution, frame, *(() if graph is None else (graph.panes(),))),
        scans=records,
        odometry=log.odometry_from,
        dead_reckoning=dead,
        calibration=feature.calibration,
        particles=hypotheses(cfg, feature),
        source=log.source,
        log_hash=log.log_hash,
        dropped=dict(log.dropped),
        findings=of_robot((*log.findings, *feature.findings, *unclear, *_little(log)), log.robot),
        graph=graph,
        scan_hash=log.scan_hash(),
        unused=log.unused,
        fixes=log.fixes,
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
    if sweep := sweep_of(log, cfg.beam, cfg.front_end):
        log = replace(log, findings=(*log.findings, Finding("scans-swept", log.robot, value=sweep)))
    log = replace(log, sweep=sweep)
    return with_calibrated_wheels(log, cfg, seed, _lit(log, cfg, seed, on_progress), on_progress)


def _lit(log: LaserLog, cfg: LaserConfig, seed: int, on_progress: Progress) -> LaserMap:
    """The map of the log as it is, with light where that tells something and contradicts no wheels."""
    began = perf_counter()
    feature = choose_feature(log, cfg)
    spent = perf_counter() - began
    made = _mapped(log, cfg, seed, feature, spent, on_progress)
    lit = contradicting(made.scans.pose, log) if feature.name in STEERING else 0.0
    if lit <= MOST_CONTRADICTING:
        return made
    bare = _mapped(log, cfg, seed, Feature("none", feature.calibration), spent, on_progress)
    unlit = contradicting(bare.scans.pose, log)
    if unlit > lit / 2:
        return made
    shares = f"in {100 * lit:.0f} % of its steps, that without in {100 * unlit:.0f} %"
    told = Finding("light-unused", log.robot, value=f"the motion found with it contradicts the wheels {shares}")
    return replace(bare, findings=(*bare.findings, told))


def _mapped(
    log: LaserLog, cfg: LaserConfig, seed: int, feature: Feature, calibrating: float, on_progress: Progress
) -> LaserMap:
    began = perf_counter()
    session = LaserSession(log.robot, cfg, seed, feature, log.sweep)
    for event in log.events():
        if session.push(event) is not None:
            on_progress(f"robot {log.robot}", len(session.infos), len(log.scans))
    spent = {"calibrate": calibrating, "estimate": perf_counter() - began}
    return map_session(session, log, feature, spent, on_progress)


WHEELS_SD = (0.01, 0.1)  # [m] and [m/m]: of wheels from scan to scan, whose stamps may be apart
CONTRADICTS = 3.0  # standard deviations from which a step contradicts them
MOST_CONTRADICTING = 0.05  # share of the steps that may


def contradicting(pose: Float[np.ndarray, "m 3"], log: LaserLog) -> float:
    """The share of the steps between the scans' poses that contradict the wheels; 0 without wheels."""
    if len(pose) < 2 or any(scan.odometry is None for scan in log.scans):
        return 0.0
    wheels = np.array([scan.odometry for scan in log.scans], float)
    step = se2.between(wheels[:-1], wheels[1:])
    apart_by = se2.between(step, se2.between(pose[:-1], pose[1:]))
    sd = WHEELS_SD[0] + WHEELS_SD[1] * np.hypot(step[:, 0], step[:, 1])
    return float(np.mean(np.hypot(apart_by[:, 0], apart_by[:, 1]) > CONTRADICTS * sd))


def with_calibrated_wheels(
    log: LaserLog, cfg: LaserConfig, seed: int, mapped: LaserMap, on_progress: Progress = no_progress
) -> LaserMap:
    """`mapped`, the map of `log` as it is, with what it tells of wheels and mounting; made anew where that matters.

    Poses of the scanner hardly depend on either where walls hold them, so that one map tells enough to make a better
    one, and that whether it holds. A factor of the ranges looks like one of the wheels: that stays told. A log some
    of whose scans were let go while it was mapped is not mapped again.
    """
    if cfg.method != "graph":
        return mapped
    began = perf_counter()
    whole = log
    if mapped.graph is not None and mapped.dead_reckoning is not None and any(mapped.graph.border):
        whole, _ = bridged(log, mapped.graph, mapped.track, mapped.dead_reckoning)
    found = _found(whole, mapped, log.scans, cfg, np.zeros(8, dtype=bool))
    if found is None:
        return mapped
    if not cfg.odometry.apply or not found.applied.any() or not all(len(scan.ranges) for scan in log.scans):
        return replace(mapped, odometry_calibration=replace(found, applied=np.zeros(8, dtype=bool)))
    first, used = mapped, replace(found, value=NOMINAL)
    for _ in range(REMADE):
        if found is None or (np.abs(found.used() - used.used()) <= SETTLED).all():
            break
        used = found
        better = replace(corrected(log, used), findings=tuple(f for f in log.findings if f.code not in GUESSED))
        mapped = _lit(better, cfg, seed, on_progress)
        found = _found(whole, mapped, better.scans, cfg, used.applied)
    last = found or used
    told = {found.code for found in mapped.findings}
    scale = tuple(f for f in first.findings if f.code == "wheels-scale" and f.code not in told)
    known = replace(last, applied=used.applied, value=np.where(used.applied, used.value, last.value))
    return replace(
        mapped,
        scan_hash=first.scan_hash,
        odometry_calibration=known,
        findings=(*mapped.findings, *scale, Finding("wheels-calibrated", log.robot, value=known.in_words())),
        timing={**mapped.timing, "made anew": perf_counter() - began},
    )


def _found(
    log: LaserLog, mapped: LaserMap, scans: Sequence[Scan], cfg: LaserConfig, before: Bool[np.ndarray, "8"]
) -> OdometryCalibration | None:
    """What the map that was made of `scans` tells of the log's own wheels; applied: what is worth it, and `before`.

    Worth it is also the lag that turns alone tell, which else makes a verdict doubtful.
    """
    found = calibrate_odometry(log, sensor_poses(mapped.scans.pose, scans), cfg.beam)
    if found is not None:
        found = replace(found, applied=before | found.worth(stated=is_stated(log)))
    late = stamp_lag(log.scan_t, np.unwrap(mapped.scans.pose[:, 2]), log.odometry) if _is_timed(log) else None
    if late is not None and lag_found(late, None, log.robot):
        found = with_lag(found, late)
    if found is None:
        return None
    return found.usual(log.scans[0].T_robot_sensor)


def _is_timed(log: LaserLog) -> bool:
    """Whether its stamps are times."""
    return not any(found.code in {"stamps-none", "stamps-equal"} for found in log.findings)


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
    views = None if graph is None or not len(graph) else keyframe_map(graph, asked=VIEWS)
    if graph is not None and views is not None:
        graph = replace(graph, glass=glass_returns(graph, views))
    result = finish(clean, session.cfg, feature, poses, session.infos, graph)
    track, dead = result.track, result.dead_reckoning
    if graph is not None and dead is not None and any(graph.border):
        clean, dead = bridged(clean, graph, track, dead)
    agreement = motion_agreement(result.scans.pose, clean.scans, session.cfg.beam)
    robot = log.robot
    heading, timed = np.unwrap(result.scans.pose[:, 2]), _is_timed(log)
    lag, drift = (ask(log.scan_t, heading, clean.odometry) if timed else None for ask in (stamp_lag, clock_drift))
    disagreement = (
        *lag_found(lag, drift, robot),
        *_placed_again(jumps(result.scans, log.scans, robot), graph),
        *wheels_disagree(track, dead, robot, agreement.factor()),
        *wheels_stand(track, dead, robot),
        *turns_alone(result.scans, log.scans, robot),
        *(() if graph is None else slides_alone(graph, log.scans, robot)),
        *wheels_leap(log.scan_t, log.scans, robot, segments=graph is not None),
    )
    measured = agreement.findings(robot)
    if not any(f.code in {"wheels-scale", "wheels-unlike"} for f in (*measured, *result.findings)):
        measured = (*measured, *wheels_unlike(track, dead, robot))
    moving_returns = {"return of something that moves": session.moving.count} if session.moving.count else {}
    left = {} if graph is None else left_graph(graph)
    told_by_graph = (segment_findings, way_bent, way_loose)
    cuts = () if graph is None else tuple(found for tell in told_by_graph for found in tell(graph))
    if graph is not None and clean.scans[0].odometry is not None:
        cuts = (*cuts, *cuts_disputed(graph, disagreement))
    cuts = (*cuts, *(() if views is None else seen_through(views)))
    result = replace(
        result,
        scan_hash=log.scan_hash(),
        dropped={**result.dropped, **moving_returns, **left},
        findings=(*instead_of(result.findings, measured), *disagreement, *cuts),
    )
    timing = {
        **spent,
        **({} if graph is None else {"last_pass": finalised - began}),
        "grid": perf_counter() - finalised,
        "ms_per_scan": 1e3 * spent["estimate"] / len(log.scans),
    }
    return replace(result, timing=timing)


def _placed_again(found: tuple[Finding, ...], graph: RobotGraph | None) -> tuple[Finding, ...]:
    """A scene that changes at once is a note where it is the only one and places hold both sides of it."""
    told = found[0].value if found else None
    if graph is None or not isinstance(told, Mapping) or told["times"] != 1 or found[0].span is None:
        return found
    if not held_over(graph, found[0].span[0]):
        return found
    together = "places hold what came before and after together"
    return (Finding("scene-change", found[0].robot, found[0].span, told, together),)


def elsewhere_from(made: LaserMap) -> float | None:
    """When [s] the robot of a map was in another place at once, where nothing ties what it saw there to the rest."""
    jump = next((f for f in made.findings if f.code == "scene-jump" and f.span is not None), None)
    graph = made.graph
    if jump is None or graph is None or jump.span is None or not set_down(graph, jump.span[0]):
        return None
    at = int(np.searchsorted(graph.t, jump.span[0]))
    ways = graph.path[at - 1] - graph.path[0], graph.path[-1] - graph.path[at]
    return jump.span[0] if min(ways) >= LONG else None


def _little(log: LaserLog) -> tuple[Finding, ...]:
    return (Finding("few-scans", log.robot, value=len(log.scans)),) if len(log.scans) < FEW else ()


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


def _tracks(log: LaserLog, poses: np.ndarray, frame: str) -> tuple[Track, Track | None, tuple[Finding, ...]]:
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
    filled, middle = of_one_moment(t, filled, order >= int(between.sum()))
    last = np.append(np.diff(t) > 0, True)
    dead = se2.between(odometry[0], odometry)
    tracks = Track(t[last], filled[last], frame=frame), Track(t[last], dead[last], frame="odom")
    if not middle.any():
        return *tracks, ()
    count = int(middle.sum())
    return *tracks, (Finding("stamps-mixed", log.robot, value=count, action="the trajectory gives their middle"),)


def of_one_moment(
    t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"], scan: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The poses, those of one moment that contradict each other at their middle, and which these are.

    t: ascending [s]; scan: which poses are those of scans. The middle is the median over x, y and heading of the rows
    within `cfg.within`, seen from the row itself.
    """
    first = np.searchsorted(t, t - MOMENT_WITHIN, side="left")
    end = np.searchsorted(t, t + MOMENT_WITHIN, side="right")
    out, replaced = np.array(pose), np.zeros(len(t), dtype=bool)
    for k in np.flatnonzero(end - first > 1).tolist():
        rows = slice(first[k], end[k])
        seen = se2.between(pose[k], pose[rows])
        if (np.hypot(seen[:, 0], seen[:, 1]) <= MOMENT_APART).all() and (np.abs(seen[:, 2]) <= MOMENT_TURNED).all():
            continue
        middle = np.median(np.repeat(seen, np.where(scan[rows], SCAN_COUNTS, 1), axis=0), axis=0)
        out[k], replaced[k] = se2.compose(pose[k], middle), True
    return out, replaced
