"""Robots that somebody picked up and put down elsewhere: which to look at, and their logs cut there.

Wheels tell nothing of being carried, so a filter either loses the robot or bends its map.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track
from ..fusion.result import Fusion
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .commanded_motion import CommandedMotion
from .config import SmoothingConfig
from .placing import placed_alone
from .relative_frame import Body, Labels, PlacingConfig, mutual_sightings, residuals
from .relocations import KidnapConfig, Relocation, denied, jumps
from .team_map import TeamMap

Mapper = Callable[[LandmarkLog], LocalMap]
Joiner = Callable[[Sequence[LocalMap]], Fusion]


@dataclass(frozen=True, slots=True)
class Cut:
    """The logs and local maps of a team whose kidnapped robots are cut.

    logs: with their cuts; main: the stretch of each robot that `local` is of; a finding of it tells of the cuts.
    """

    logs: tuple[LandmarkLog, ...]
    main: tuple[LandmarkLog, ...]
    local: tuple[LocalMap, ...]
    fusion: Fusion


def cut_kidnapped(
    logs: Sequence[LandmarkLog],
    local: Sequence[LocalMap],
    fusion: Fusion,
    smoothing: SmoothingConfig,
    placing: PlacingConfig,
    cfg: KidnapConfig,
    mapper: Mapper,
    join: Joiner,
) -> Cut:
    """The team with every robot's log cut where the robot was put down elsewhere, its map from the longest stretch.

    The robot that fits the team's map worst is looked at first; after each that was carried the rest are judged anew.
    A team in which nobody was comes back as it is. mapper, join: how local maps and their fusion are made.
    """
    whole, main, maps = list(logs), list(logs), list(local)
    cleared: set[str] = set()
    for _ in range(cfg.most):
        by = {log.robot: log for log in main}
        suspects = _suspects(maps, fusion, by, cfg, placing, smoothing)
        relocated = None
        for robot in suspects:
            k = next(i for i, log in enumerate(main) if log.robot == robot)
            if robot in cleared or main[k] is not logs[k]:
                continue
            moments = _moments(main[k], maps, fusion, cfg, placing, smoothing, mapper, join)
            if moments:
                relocated = k, moments
                break
            cleared.add(robot)
        if relocated is None:
            break
        k, moments = relocated
        whole[k] = replace(logs[k], cuts=tuple(np.unique(moments).tolist()))
        stretches = whole[k].stretches()
        main[k] = max(stretches, key=lambda part: len(part.sightings))
        local_map = mapper(main[k])
        maps[k] = replace(local_map, findings=(*local_map.findings, _put_down(logs[k], moments)))
        fusion = join(maps)
        cleared.clear()
    return Cut(tuple(whole), tuple(main), tuple(maps), fusion)


def with_stretches(
    maps: Sequence[TeamMap], cut: Cut, smoothing: SmoothingConfig, placing: PlacingConfig
) -> tuple[tuple[TeamMap, ...], tuple[LandmarkLog, ...], tuple[Finding, ...]]:
    """The maps with the paths of cut robots over all stretches that sightings place, and the logs of these stretches.

    Also a finding for each stretch that nothing places, which is left out.
    """
    out, logs, notes = list(maps), list(cut.logs), []
    for i, log in enumerate(cut.logs):
        k = next((j for j, team in enumerate(out) if log.robot in team.tracks), None)
        if not log.cuts or k is None:
            continue
        team, by = out[k], {other.robot: other for other in cut.logs}
        others = {robot: track for robot, track in team.tracks.items() if robot != log.robot}
        body = Body(others, dict(zip(team.landmarks.ids, team.landmarks.mean, strict=True)))
        pieces, kept = [], []
        for part in log.stretches():
            if len(part) and part.span == cut.main[i].span:
                track: Track | None = team.tracks[log.robot]
            else:
                track = _placed(body, part, by, cut.fusion.labels, placing, smoothing) if len(part) else None
            if track is not None:
                pieces.append(track)
                kept.append(part)
            elif len(part):
                a, b = (end - log.span[0] for end in part.span)
                why = f"nothing places it from {a:.1f} to {b:.1f} s of its log"
                notes.append(Finding("unplaced", log.robot, value=why, action="left out"))
        ends = [(float(a.t[-1]), float(b.t[0])) for a, b in pairwise(pieces)]
        gaps = tuple(end for end, (a, b) in zip(ends, pairwise(kept), strict=True) if _rows_between(log, a, b))
        left = {**team.left_out, log.robot: gaps} if gaps else team.left_out
        out[k] = replace(team, tracks={**team.tracks, log.robot: _in_one(pieces)}, left_out=left)
        logs[i] = replace(_in_one_log(log, kept), cuts=tuple(part.span[0] for part in kept[1:]))
    return tuple(out), tuple(logs), tuple(notes)


def _rows_between(log: LandmarkLog, a: LandmarkLog, b: LandmarkLog) -> bool:
    """Whether a stretch of the log lies between two of its others."""
    return len(log.chosen(lambda t: (t > a.span[1]) & (t < b.span[0]))) > 0


def _placed(
    body: Body,
    part: LandmarkLog,
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> Track | None:
    """The trajectory of a stretch in the body's frame, with the covariance from which a place is believed at all."""
    track = placed_alone(body, part, {**logs, part.robot: part}, labels, placing, smoothing)
    if track is None:
        return None
    cov = np.diag([placing.sure_xy**2, placing.sure_xy**2, placing.sure_theta**2])
    return Track(track.t, track.pose, np.tile(cov, (len(track.t), 1, 1)), track.frame)


def _in_one(tracks: Sequence[Track]) -> Track:
    known = [track.cov for track in tracks if track.cov is not None]
    cov = np.concatenate(known) if len(known) == len(tracks) else None
    t, pose = (np.concatenate([getattr(track, name) for track in tracks]) for name in ("t", "pose"))
    return Track(t, pose, cov, tracks[0].frame)


def _in_one_log(log: LandmarkLog, parts: Sequence[LandmarkLog]) -> LandmarkLog:
    """The rows of `log` that are in one of `parts`, which are stretches of it."""

    def chosen(t: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        return np.asarray(np.any([(t >= part.span[0]) & (t <= part.span[1]) for part in parts], axis=0))

    return log.chosen(chosen)


def _put_down(log: LandmarkLog, moments: Sequence[Relocation]) -> Finding:
    begin, when = log.span[0], []
    for a, b in moments:
        after = f"{a:.1f} (after {a - begin:.1f} s of its log)"
        when.append(after if a == b else f"{after} or within {b - a:.1f} s from there")
    span = float(moments[0][0]), float(moments[-1][1])
    cut = "its path is cut there, its own map is of the longest stretch"
    return Finding("put-down", log.robot, span, ", ".join(when), cut)


def _suspects(
    maps: Sequence[LocalMap],
    fusion: Fusion,
    logs: Mapping[str, LandmarkLog],
    cfg: KidnapConfig,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> list[str]:
    """Robots with wheels worth a closer look, the worst first."""
    bad: dict[str, int] = {}
    for m in maps:
        log = logs[m.robot]
        if log.odometry is None or not len(m.submap.ids):
            continue
        restless = sum(not name.startswith("barcode:") for name in m.restless)
        n = _bad_bins(m, fusion, logs, cfg, placing)
        if n >= cfg.bad_bins or restless or _bent(m.track, log, _calibrated(smoothing, m), cfg.bent_within) > cfg.bent:
            bad[m.robot] = n
    return sorted(bad, key=lambda robot: (-bad[robot], in_order(robot)))


def _bad_bins(
    m: LocalMap, fusion: Fusion, logs: Mapping[str, LandmarkLog], cfg: KidnapConfig, placing: PlacingConfig
) -> int:
    """In how many stretches of the log most of what the robot saw lies elsewhere in the largest map."""
    first = fusion.components[0] if fusion.components else None
    if first is None:
        return 0
    if m.robot not in first.robots:
        return int(np.ptp(m.track.t) // cfg.bin) if len(m.track.t) else 0
    T = first.frames[m.robot]
    own = Body({m.robot: Track(m.track.t, se2.compose(T, m.track.pose))}, {})
    z = mutual_sightings(_landmarks(first.map), own, logs, fusion.labels)
    if not len(z):
        return 0
    agrees = np.square(residuals(z, np.zeros(3), placing)).sum(axis=-1) < placing.inlier**2
    number = ((z.t - z.t.min()) // cfg.bin).astype(int)
    n, good = np.bincount(number), np.bincount(number, weights=agrees)
    return int(((n >= cfg.bin_sightings) & (good < cfg.bin_share * n)).sum())


def _bent(track: Track, log: LandmarkLog, smoothing: SmoothingConfig, span: int) -> float:
    """The most [m] that the track deviates from the wheels within `span` seconds."""
    if log.odometry is None or not len(track.t) or np.ptp(track.t) <= span:
        return 0.0
    t = np.arange(track.t[0], track.t[-1], 1.0)
    known, motion = smoothing.calibration, CommandedMotion.of(log.odometry, smoothing.motion.hold)
    said, k = motion.at(t, known.speed_scale, known.turn_scale, known.lag)[0], span
    was = se2.interpolate(t, track.t, track.pose)
    miss = se2.between(se2.between(said[:-k], said[k:]), se2.between(was[:-k], was[k:]))
    return float(np.hypot(miss[:, 0], miss[:, 1]).max(initial=0.0))


def _moments(
    log: LandmarkLog,
    maps: Sequence[LocalMap],
    fusion: Fusion,
    cfg: KidnapConfig,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
    mapper: Mapper,
    join: Joiner,
) -> tuple[Relocation, ...]:
    """When [s] the robot was put down elsewhere: against each half of its own log, then against what others mapped.

    A robot that nobody carried contradicts no half of its own; where it was carried, one half is whole. Names that had
    no fixed place in its map may be things that move: what they alone tell is not believed.
    """
    a, b = log.span
    restless = {name for m in maps if m.robot == log.robot for name in m.restless}
    for half in (log.within(-np.inf, 0.5 * (a + b)), log.within(0.5 * (a + b), np.inf)):
        own = mapper(half) if len(half.sightings) else None
        if own is not None and len(own.submap.ids) >= cfg.landmarks:
            known = _calibrated(smoothing, own)
            reference = _landmarks(own.submap.landmarks)
            relocations = jumps(reference, log, {}, cfg, placing, known)
            if relocations and not denied(relocations, reference, log, {}, restless, cfg, placing, known):
                return relocations
    others = join([m for m in maps if m.robot != log.robot])
    first = others.components[0] if others.components else None
    if first is None or len(first.robots) < 2 or len(first.map) < cfg.landmarks:
        return ()
    reference = _landmarks(first.map)
    relocations = jumps(reference, log, fusion.labels, cfg, placing, smoothing)
    refuted = relocations and denied(relocations, reference, log, fusion.labels, restless, cfg, placing, smoothing)
    return () if refuted else relocations


def _calibrated(smoothing: SmoothingConfig, m: LocalMap) -> SmoothingConfig:
    """With the wheels as a map of the robot's own found them."""
    calibration = {name: m.calibration[name][0] for name in ("turn_scale", "lag") if name in m.calibration}
    return replace(smoothing, calibration=replace(smoothing.calibration, **calibration))


def _landmarks(m: LandmarkMap) -> Body:
    return Body({}, dict(zip(m.ids, m.mean, strict=True)))
