"""A robot's local map while its log plays: as it stood at each of several times, from one pass of the filter.

What the filter knew is kept at those times and made a map afterwards, from sums that grow with the rows; so all maps on
the way together cost one pass and what they hold.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from ..kernels.landmarks.ekf_state import POSE, RANGE_SCALE
from .config import EkfSlamConfig
from .ekf_replay import Played
from .landmark_map import LocalMap, RobotSightings
from .mapping import config_for, map_of, restless, robot_sightings, without_impossible
from .without_odometry import Known, parts

OLDER = 0.2  # share of new rows in a piece of map from which a robot without odometry is mapped anew


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
    """The map of `log` as `local_map` gives it, and those on the way to it at `times` [s], ascending.

    On the way past poses are not corrected, and a landmark without a fixed place is left out of the map, not of the
    filter. tracks: whether those maps hold all poses until then, or the latest alone.
    """
    whole, first = map_of(log, cfg, times)
    cfg = config_for(log, cfg)
    log = without_impossible(log, cfg)
    if cfg.odometry:
        return Growth(whole, tuple(times), tuple(_on_the_way(log, first, cfg, tracks=tracks)), first.filtered)
    return Growth(whole, tuple(times), tuple(_by_pieces(log, cfg, times)), first.filtered)


def growing_maps(log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float]) -> Sequence[LocalMap | None]:
    """The map of the rows until each of `times` [s], ascending; None while there is no landmark."""
    return grow(log, cfg, times, tracks=True).maps


def _on_the_way(log: LandmarkLog, played: Played, cfg: EkfSlamConfig, *, tracks: bool) -> Iterator[LocalMap | None]:
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
        submap, moving = taken.state.submap, restless(seen.ids, judged, down, cfg)
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
        now = parts(cut.sightings, cfg.piece_gap)
        if now and (len(now) > pieces or len(now[-1]) >= (1 + OLDER) * rows):
            m, _ = map_of(cut, cfg, known=known)
            last = m if len(m.submap.ids) else None
            rows, pieces = len(now[-1]), len(now)
        yield last
