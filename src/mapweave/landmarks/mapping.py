"""One robot's log becomes its local map: all of it through EKF-SLAM, and what there is to say about the result.

Intermediate maps, as they stood at each of several times, come from the same pass: what the filter knew is kept at
those times and made a map afterwards, from sums that grow with the rows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry, Track
from ..kernels.landmarks.ekf import HEAD, POSE, RANGE_SCALE
from . import ekf_slam
from .config import (
    PIECE_GAP,
    PIECE_OLDER,
    RESTLESS_MOST,
    RESTLESS_SHARE,
    RESTLESS_SIGHTINGS,
    WARN_DOWN_WEIGHTED,
    WARN_NIS,
    EkfSlamConfig,
)
from .ekf_replay import ReplayedLog, replay
from .landmark_map import LocalMap, RobotSightings, view_of
from .without_odometry import Known, parts, replay_in_pieces

MOST_SPEED = 1e3  # [m/s] beyond which a command is no command
MOST_TURN = 1e3  # [rad/s] beyond which a command is no command
MOST_RANGE = 1e5  # [m] beyond which a sighting is none
MOST_BEARING = 1e3  # [rad] beyond which a sighting is none

CALIBRATION = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")


def local_map(log: LandmarkLog, cfg: EkfSlamConfig | None = None, seed: int = 0) -> LocalMap:  # noqa: ARG001
    """The map of `log` in `local_K`; raises EstimateError when the filter leaves finite numbers.

    A name that keeps contradicting itself has no fixed place: it is left out and told, an unlisted barcode as
    misreads; so are rows with numbers that no robot drives or sees. Nothing is random here; `seed` is what every
    estimator takes.
    """
    return map_of(log, cfg or EkfSlamConfig())[0]


def map_of(
    log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float] = (), known: Known | None = None
) -> tuple[LocalMap, ReplayedLog]:
    """The map of `log`, and the first pass over it, in which the filter was kept at each of `times` [s].

    Of a robot without odometry, whose pieces of map are tied anew by every row, nothing is kept at times; known: its
    pieces that were played before.
    """
    log = without_impossible(log)
    cfg = config_for(log, cfg)
    first = done = replay(log, cfg, times=times) if cfg.odometry else replay_in_pieces(log, cfg, known)
    dropped, findings, kept = dict(log.dropped), list(log.findings), log
    left_out: list[str] = []
    for _ in range(RESTLESS_MOST):
        name = _restless(done.seen, done.weight)
        if name is None:
            break
        gone = kept.sightings.counts()[name]
        reason = "misread barcode" if name.startswith("barcode:") else "sighting: no fixed place"
        dropped[reason] = dropped.get(reason, 0) + gone
        findings.append(Finding("landmark-moves", log.robot, value={"name": name, "value": gone}, action="left out"))
        left_out.append(name)
        stays = np.array([other != name for other in kept.sightings.ids], bool)
        kept = replace(kept, sightings=kept.sightings.select(stays[kept.sightings.what]))
        done = replay(kept, cfg) if cfg.odometry else replay_in_pieces(kept, cfg)
    own_map = _result(log, cfg, done, dropped, [*findings, *done.findings])
    return replace(own_map, restless=tuple(left_out)), first


def robot_sightings(log: LandmarkLog) -> RobotSightings:
    table = log.sightings
    robots = np.array([not ekf_slam.is_landmark(name) for name in table.ids], bool)
    r = table.select(robots[table.what]) if len(table) else table
    return RobotSightings(r.t, tuple(r.ids[k] for k in r.what), r.range, r.bearing)


def config_for(log: LandmarkLog, cfg: EkfSlamConfig) -> EkfSlamConfig:
    """`cfg` for this log: a robot without odometry wanders."""
    return replace(cfg, odometry=False) if log.odometry is None else cfg


def without_impossible(log: LandmarkLog) -> LandmarkLog:
    """The log without rows beyond what `cfg` lets a robot drive or see, which are counted and told."""
    seen, odometry = log.sightings, log.odometry
    sane = (np.abs(seen.range) <= MOST_RANGE) & (np.abs(seen.bearing) <= MOST_BEARING)
    dropped = {"sighting: impossible": int((~sane).sum())}
    if odometry is not None:
        drives = (np.abs(odometry.v) <= MOST_SPEED) & (np.abs(odometry.w) <= MOST_TURN)
        dropped["odometry: impossible"] = int((~drives).sum())
        odometry = Odometry(odometry.t[drives], odometry.v[drives], odometry.w[drives])
    dropped = {reason: n for reason, n in dropped.items() if n}
    if not dropped:
        return log
    findings = [
        Finding("rows-impossible", log.robot, value={"value": n, "what": reason.split(":")[0]}, action="left out")
        for reason, n in dropped.items()
    ]
    return replace(
        log,
        odometry=odometry,
        sightings=seen.select(sane),
        dropped={**log.dropped, **dropped},
        findings=(*log.findings, *findings),
    )


def _restless(seen: SightingTable, weights: Float[np.ndarray, " n"]) -> str | None:
    """The landmark with the largest share of its sightings down-weighted, if that is most of them."""
    judged = np.isfinite(weights)
    n = len(seen.ids)
    down = np.bincount(seen.what[judged & (weights < 1.0)], minlength=n)
    return restless(seen.ids, np.bincount(seen.what[judged], minlength=n), down)


def restless(ids: Sequence[str], judged: Int[np.ndarray, " k"], down: Int[np.ndarray, " k"]) -> str | None:
    """The one of `ids` of whose `judged` sightings the largest share is down-weighted, if that is most of them."""
    worst, name = RESTLESS_SHARE, None
    for k, other in enumerate(ids):
        share = float(down[k] / judged[k]) if judged[k] and judged[k] >= RESTLESS_SIGHTINGS else 0.0
        if share > worst:
            worst, name = share, other
    return name


def _result(
    log: LandmarkLog, cfg: EkfSlamConfig, done: ReplayedLog, dropped: dict[str, int], findings: list[Finding]
) -> LocalMap:
    all_counts = done.seen.counts()
    counts = {name: all_counts[name] for name in done.submap.ids}
    unused = sum(n for name, n in all_counts.items() if ekf_slam.is_landmark(name) and name not in counts)
    if unused:
        dropped["sighting: landmark not confirmed"] = unused
    judged = np.isfinite(done.nis)
    nis_median = float(np.median(done.nis[judged])) if judged.any() else None
    down = int((done.weight[judged] < 1.0).sum())
    if judged.any() and down > WARN_DOWN_WEIGHTED * judged.sum():
        findings.append(Finding("sightings-doubted", log.robot, value={"value": down, "all": int(judged.sum())}))
    if nis_median is not None and nis_median > WARN_NIS:
        findings.append(Finding("sightings-inconsistent", log.robot, value=nis_median))
    return LocalMap(
        robot=log.robot,
        submap=done.submap,
        track=done.track,
        sightings=counts,
        robot_sightings=robot_sightings(log),
        odometry="velocity" if cfg.odometry else "none",
        source=log.source,
        log_hash=log.log_hash,
        nis_median=nis_median,
        down_weighted=down,
        dropped=dropped,
        calibration=_calibration(done, cfg),
        findings=tuple(findings),
        first_seen={name: t for name, t in done.seen.first().items() if name in counts},
        view=view_of(done.track, done.seen, done.submap.ids, done.submap.mean),
    )


def _calibration(done: ReplayedLog, cfg: EkfSlamConfig) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of what was estimated."""
    if not cfg.odometry:
        return {}
    prior = (cfg.speed_scale_sd, cfg.turn_scale_sd, cfg.lag_sd, cfg.bearing_bias_sd, cfg.range_scale_sd)
    sd = np.sqrt(np.maximum(np.diag(done.P)[POSE:HEAD], 0.0))
    return {name: (float(done.x[POSE + k]), float(sd[k])) for k, name in enumerate(CALIBRATION) if prior[k] > 0}


@dataclass(frozen=True, slots=True)
class Growth:
    """whole: the map of all rows; maps: the map at each of `times` [s], None while there was no landmark.

    filtered: the filter's poses, each as it was at its time, where the robot has wheels.
    """

    whole: LocalMap
    times: tuple[float, ...]
    maps: tuple[LocalMap | None, ...]
    filtered: Track

    def at(self, times: Sequence[float]) -> "Growth":
        """The maps at these times alone, which are among all."""
        index = {t: k for k, t in enumerate(self.times)}
        return replace(self, times=tuple(times), maps=tuple(self.maps[index[t]] for t in times))


def grow(log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float], *, tracks: bool = False) -> Growth:
    """The map of `log` as `local_map` gives it, and the intermediate ones at `times` [s], ascending.

    In those past poses are not corrected, and a landmark without a fixed place is left out of the map, not of the
    filter. tracks: whether those maps hold all poses until then, or the latest alone.
    """
    whole, first = map_of(log, cfg, times)
    log = without_impossible(log)
    cfg = config_for(log, cfg)
    if cfg.odometry:
        return Growth(whole, tuple(times), tuple(_on_the_way(log, first, tracks=tracks)), first.filtered)
    return Growth(whole, tuple(times), tuple(_by_pieces(log, cfg, times)), first.filtered)


def _on_the_way(log: LandmarkLog, played: ReplayedLog, *, tracks: bool) -> Iterator[LocalMap | None]:
    seen, track = log.sightings, played.filtered
    judged, down, counts = (np.zeros(len(seen.ids), np.int64) for _ in range(3))
    robots = robot_sightings(log)
    done = 0
    for taken in played.taken:
        what, weight = seen.what[done : taken.seen], played.weight[done : taken.seen]
        known = np.isfinite(weight)
        n = len(seen.ids)
        counts += np.bincount(what, minlength=n)
        judged += np.bincount(what[known], minlength=n)
        down += np.bincount(what[known & (weight < 1.0)], minlength=n)
        done = taken.seen
        if taken.state is None:
            yield None
            continue
        submap, moving = taken.state.submap, restless(seen.ids, judged, down)
        if moving in submap.ids:
            keep = np.array([name != moving for name in submap.ids])
            rows = np.concatenate([[True] * POSE, np.repeat(keep, 2)])
            ids = tuple(name for name in submap.ids if name != moving)
            submap = replace(submap, ids=ids, mean=submap.mean[keep], cov=submap.cov[np.ix_(rows, rows)])
        if not submap.ids:
            yield None
            continue
        scale = np.array([taken.state.x[RANGE_SCALE], taken.state.x[RANGE_SCALE], 1.0])
        poses = slice(0 if tracks else max(taken.tracked - 1, 0), taken.tracked)
        cov = None if track.cov is None else track.cov[poses] * np.outer(scale, scale)
        met = int(np.searchsorted(robots.t, seen.t[done - 1], side="right")) if done else 0
        index = {name: k for k, name in enumerate(seen.ids)}
        yield LocalMap(
            robot=log.robot,
            submap=submap,
            track=Track(track.t[poses], track.pose[poses] * scale, cov, track.frame),
            sightings={name: int(counts[index[name]]) for name in submap.ids},
            robot_sightings=RobotSightings(
                robots.t[:met], robots.target[:met], robots.range[:met], robots.bearing[:met]
            ),
            source=log.source,
            log_hash=log.log_hash,
        )


def _by_pieces(log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float]) -> Iterator[LocalMap | None]:
    """Of a robot without odometry: pieces that ended are never played again, and the last only when it has grown."""
    known: Known = {}
    last, rows, pieces = None, 0, 0
    for t in times:
        cut = log.until(t)
        now = parts(cut.sightings, PIECE_GAP)
        if now and (len(now) > pieces or len(now[-1]) >= (1 + PIECE_OLDER) * rows):
            m, _ = map_of(cut, cfg, known=known)
            last = m if len(m.submap.ids) else None
            rows, pieces = len(now[-1]), len(now)
        yield last
