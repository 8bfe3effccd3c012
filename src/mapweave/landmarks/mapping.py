"""One robot's log becomes its local map: all of it through EKF-SLAM, and what there is to say about the result."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry, Track
from ..core.run import run
from ..kernels.landmarks.ekf_state import HEAD, POSE, RANGE_SCALE
from . import ekf_slam
from .config import EkfSlamConfig
from .ekf_replay import Played, play
from .landmark_map import LocalMap, RobotSightings
from .without_odometry import play_in_pieces

CALIBRATION = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")


def local_map(log: LandmarkLog, cfg: EkfSlamConfig | None = None, seed: int = 0) -> LocalMap:  # noqa: ARG001
    """The map of `log` in `local_K`; raises EstimateError when the filter leaves finite numbers.

    A name that keeps contradicting itself has no fixed place: it is left out and told, an unlisted barcode as
    misreads; so are rows with numbers that no robot drives or sees. Nothing is random here; `seed` is what every
    estimator takes.
    """
    cfg = config_for(log, cfg or EkfSlamConfig())
    estimate = play if cfg.odometry else play_in_pieces
    log = without_impossible(log, cfg)
    dropped, warnings, kept = dict(log.dropped), list(log.warnings), log
    done = estimate(kept, cfg)
    for _ in range(cfg.restless_most):
        name = _restless(done.seen, done.weight, cfg)
        if name is None:
            break
        gone = kept.sightings.counts()[name]
        reason = "misread barcode" if name.startswith("barcode:") else "sighting: no fixed place"
        dropped[reason] = dropped.get(reason, 0) + gone
        warnings.append(f"{name} was seen {gone} times but at no fixed place: left out")
        stays = np.array([other != name for other in kept.sightings.ids], bool)
        kept = replace(kept, sightings=kept.sightings.select(stays[kept.sightings.what]))
        done = estimate(kept, cfg)
    return _result(log, cfg, done, dropped, [*warnings, *done.warnings])


def growing_maps(
    log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float], seed: int = 0
) -> Iterator[LocalMap | None]:
    """The map of the rows until each of `times` [s], ascending, one after the other; None while there is no landmark.

    The filter goes on from map to map, so that all of them cost what the last does; past poses are not corrected, and
    a landmark without a fixed place is left out of the map, not of the filter. A robot without odometry, whose pieces
    of map are tied anew by every row, is mapped from its first row each time.
    """
    cfg = config_for(log, cfg)
    log = without_impossible(log, cfg)
    if not cfg.odometry:
        for t in times:
            cut = log.until(t)
            m = local_map(cut, cfg, seed) if len(cut.sightings) else None
            yield m if m is not None and len(m.submap.ids) else None
        return
    steps = run(ekf_slam, cfg, log.events(times), seed)
    following = next(steps, None)
    state, weights, tracks = None, [np.zeros(0)], [ekf_slam.NOWHERE]
    for t in times:
        while following is not None and following.t <= t:
            state = following.state
            weights.append(following.info.weight)
            tracks.append(following.info.track)
            following = next(steps, None)
        m = None if state is None else _map_so_far(log.until(t), state, np.concatenate(weights), tracks, cfg)
        yield m if m is not None and len(m.submap.ids) else None


def _map_so_far(
    log: LandmarkLog,
    state: ekf_slam.EkfSlamState,
    weight: Float[np.ndarray, " n"],
    tracks: Sequence[Track],
    cfg: EkfSlamConfig,
) -> LocalMap:
    """What a filter that has worked in all of `log` hands over."""
    submap, moving = state.submap, _restless(log.sightings, weight, cfg)
    if moving in submap.ids:
        keep = np.array([name != moving for name in submap.ids])
        rows = np.concatenate([[True] * POSE, np.repeat(keep, 2)])
        ids = tuple(name for name in submap.ids if name != moving)
        submap = replace(submap, ids=ids, mean=submap.mean[keep], cov=submap.cov[np.ix_(rows, rows)])
    scale = np.array([state.x[RANGE_SCALE], state.x[RANGE_SCALE], 1.0])
    pose = np.concatenate([track.pose for track in tracks]) * scale
    cov = np.concatenate([track.cov for track in tracks if track.cov is not None]) * np.outer(scale, scale)
    counts = log.sightings.counts()
    return LocalMap(
        robot=log.robot,
        submap=submap,
        track=Track(np.concatenate([track.t for track in tracks]), pose, cov, state.frame),
        sightings={name: counts[name] for name in submap.ids},
        robot_sightings=_robot_sightings(log),
        source=log.source,
        log_hash=log.log_hash,
    )


def _robot_sightings(log: LandmarkLog) -> RobotSightings:
    table = log.sightings
    robots = np.array([not ekf_slam.is_landmark(name) for name in table.ids], bool)
    r = table.select(robots[table.what]) if len(table) else table
    return RobotSightings(r.t, tuple(r.ids[k] for k in r.what), r.range, r.bearing)


def config_for(log: LandmarkLog, cfg: EkfSlamConfig) -> EkfSlamConfig:
    """`cfg` for this log: a robot without odometry wanders."""
    return replace(cfg, odometry=False) if log.odometry is None else cfg


def without_impossible(log: LandmarkLog, cfg: EkfSlamConfig) -> LandmarkLog:
    """The log without rows beyond what `cfg` lets a robot drive or see, which are counted and told."""
    seen, odometry = log.sightings, log.odometry
    sane = (np.abs(seen.range) <= cfg.most_range) & (np.abs(seen.bearing) <= cfg.most_bearing)
    told = {"sighting: impossible": int((~sane).sum())}
    if odometry is not None:
        drives = (np.abs(odometry.v) <= cfg.most_speed) & (np.abs(odometry.w) <= cfg.most_turn)
        told["odometry: impossible"] = int((~drives).sum())
        odometry = Odometry(odometry.t[drives], odometry.v[drives], odometry.w[drives])
    told = {reason: n for reason, n in told.items() if n}
    if not told:
        return log
    warnings = [
        f"{n} {reason.split(':')[0]} rows held numbers beyond any robot: left out" for reason, n in told.items()
    ]
    return replace(
        log,
        odometry=odometry,
        sightings=seen.select(sane),
        dropped={**log.dropped, **told},
        warnings=(*log.warnings, *warnings),
    )


def _restless(seen: SightingTable, weights: Float[np.ndarray, " n"], cfg: EkfSlamConfig) -> str | None:
    """The landmark with the largest share of its sightings down-weighted, if that is most of them."""
    worst, name = cfg.restless_share, None
    for k, other in enumerate(seen.ids):
        weight = weights[seen.what == k]
        weight = weight[np.isfinite(weight)]
        share = float((weight < 1.0).mean()) if len(weight) >= cfg.restless_sightings else 0.0
        if share > worst:
            worst, name = share, other
    return name


def _result(
    log: LandmarkLog, cfg: EkfSlamConfig, done: Played, dropped: dict[str, int], warnings: list[str]
) -> LocalMap:
    all_counts = done.seen.counts()
    counts = {name: all_counts[name] for name in done.submap.ids}
    unused = sum(n for name, n in all_counts.items() if ekf_slam.is_landmark(name) and name not in counts)
    if unused:
        dropped["sighting: landmark not confirmed"] = unused
    judged = np.isfinite(done.nis)
    nis_median = float(np.median(done.nis[judged])) if judged.any() else None
    down = int((done.weight[judged] < 1.0).sum())
    if judged.any() and down > cfg.warn_down_weighted * judged.sum():
        warnings.append(f"{down} of {int(judged.sum())} sightings had to be down-weighted: its map may be wrong")
    if nis_median is not None and nis_median > cfg.warn_nis:
        warnings.append(f"sightings disagree with the filter: median NIS {nis_median:.1f}, expected about 1.4")
    return LocalMap(
        robot=log.robot,
        submap=done.submap,
        track=done.track,
        sightings=counts,
        robot_sightings=_robot_sightings(log),
        odometry="velocity" if cfg.odometry else "none",
        source=log.source,
        log_hash=log.log_hash,
        nis_median=nis_median,
        down_weighted=down,
        dropped=dropped,
        calibration=_calibration(done, cfg),
        warnings=tuple(warnings),
    )


def _calibration(done: Played, cfg: EkfSlamConfig) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of what was estimated."""
    if not cfg.odometry:
        return {}
    prior = (cfg.speed_scale_sd, cfg.turn_scale_sd, cfg.lag_sd, cfg.bearing_bias_sd, cfg.range_scale_sd)
    sd = np.sqrt(np.maximum(np.diag(done.P)[POSE:HEAD], 0.0))
    return {name: (float(done.x[POSE + k]), float(sd[k])) for k, name in enumerate(CALIBRATION) if prior[k] > 0}
