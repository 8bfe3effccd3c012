"""Robots that somebody picked up and put down elsewhere: which to look at, where they lie, and their logs cut there.

Wheels tell nothing of being carried, so a filter either loses the robot or bends its map.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track
from ..fusion.result import Fusion
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .config import MOTION_NOISE_HOLD, PlacingConfig, SmoothingConfig
from .relation import PLACING_INLIER, SURE_THETA, residuals
from .relative_frame import Body, Labels, Windows, carried_by_wheels, mutual_sightings, placed_alone, placed_windows
from .robot_part import CommandedMotion
from .team_map import TeamMap

KIDNAP_LANDMARKS = 4  # of a map against which a robot is placed

KIDNAP_BIN = 10.0  # [s] of a log in which sightings are compared with the map
BIN_SIGHTINGS = 6  # in a bin at least, for it to count
BIN_SHARE = 0.4  # of the sightings of a bin that must agree
BAD_BINS = 2  # bins that do not agree, from which a robot is looked at
KIDNAP_BENT = 0.2  # [m] by which its path differs from its wheels as calibrated, from which it is, within so many
BENT_WITHIN = 6  # seconds
KIDNAP_WINDOW = 8.0  # [s] of a log that is placed on its own,
KIDNAP_RUN = 3  # and how many of them follow from each other on either side of a cut;
LONG_WINDOW = 30.0  # [s] of longer ones, for robots that see little,
LONG_RUN = 2  # and how many of those
KIDNAP_BACK = 4  # windows back, to one of which the next must follow
KIDNAP_FITS = 0.5  # [m] by which a place may differ from what wheels say of the one before, [rad] its heading,
FITS_SHARE = 0.3  # and as a share of the distance and of the angle
KIDNAP_CARRIED = 0.8  # [m] by which it does where the robot was carried, or
CARRIED_TURN = 1.2  # [rad] its heading,
CARRIED_SHARE = 0.25  # both beyond that share of all the distance and angle driven in between
KIDNAP_BLIND = 4.0  # [s] without a sighting, from which it is left open when in between it was carried
KIDNAP_MOST = 5  # robots, one after the other


NEXT = 1e-3  # [s] after a stamp that is still of the stretch before


class Relocation(NamedTuple):
    """The robot was put down elsewhere between these stamps [s], which are one where that is known."""

    begin: float
    end: float


def jumps(
    reference: Body,
    log: LandmarkLog,
    labels: Labels,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> tuple[Relocation, ...]:
    """The moments across which places in `reference` do not follow from each other, though they do on either side."""
    wheel_track = carried_by_wheels(log, {}, smoothing)
    for length, least in ((KIDNAP_WINDOW, KIDNAP_RUN), (LONG_WINDOW, LONG_RUN)):
        windowed = replace(placing, window=length)
        windows = placed_windows(reference, log, wheel_track, {log.robot: log}, labels, windowed)
        out = []
        for before, after in pairwise(_runs(windows, wheel_track, least)):
            i, j = before[-1], after[0]
            if _carried(windows, i, j, wheel_track):
                out.append(_moment(windows, i, j, wheel_track, placing, KIDNAP_BLIND))
        if out:
            return tuple(out)
    return ()


def denied(
    moments: Sequence[Relocation],
    reference: Body,
    log: LandmarkLog,
    labels: Labels,
    restless: Collection[str],
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> bool:
    """Whether landmarks that are not `restless` place the robot on either side of every moment, and deny it."""
    names = {labels.get(log.robot, {}).get(name, name) for name in restless}
    still = Body({}, {name: place for name, place in reference.landmarks.items() if name not in names})
    if not names or len(still.landmarks) < KIDNAP_LANDMARKS or jumps(still, log, labels, placing, smoothing):
        return False
    wheel_track = carried_by_wheels(log, {}, smoothing)
    windows = placed_windows(still, log, wheel_track, {log.robot: log}, labels, replace(placing, window=KIDNAP_WINDOW))
    placed = [windows.t[k] for run in _runs(windows, wheel_track, KIDNAP_RUN) for k in (run[0], run[-1])]
    return bool(placed) and all(min(placed) < m.begin and m.end < max(placed) for m in moments)


def _runs(windows: Windows, wheel_track: Track, least: int) -> list[list[int]]:
    """At least `least` windows that follow from each other; runs that begin inside another are left out."""
    runs: list[list[int]] = []
    for k in range(len(windows.t)):
        near = [run for run in runs if k - run[-1] <= KIDNAP_BACK]
        fits = [run for run in near if _follows(windows, run[-1], k, wheel_track, KIDNAP_FITS, KIDNAP_FITS, FITS_SHARE)]
        if fits:
            max(fits, key=len).append(k)
        else:
            runs.append([k])
    solid = [run for run in runs if len(run) >= least]
    ends, out = -1, []
    for run in solid:
        if run[0] > ends:
            out.append(run)
            ends = run[-1]
    return out


def _follows(windows: Windows, i: int, j: int, wheel_track: Track, floor: float, turn: float, share: float) -> bool:
    """Whether window j lies where the wheels lead from window i, give or take."""
    said, miss = _missed(windows, i, j, wheel_track)
    angle = _driven(wheel_track, windows.t[i], windows.t[j])[1]
    near = float(np.hypot(miss[0], miss[1])) < floor + share * float(np.hypot(said[0], said[1]))
    return near and abs(float(miss[2])) < turn + share * angle


def _carried(windows: Windows, i: int, j: int, wheel_track: Track) -> bool:
    """Whether window j lies where no wheels lead from window i, however far off their scales may be.

    What they may err by grows with all that was driven in between, to and fro, and sideways with the angle too, half
    the way on average after the turn: over minutes without a place they tell nothing.
    """
    miss = _missed(windows, i, j, wheel_track)[1]
    way, angle = _driven(wheel_track, windows.t[i], windows.t[j])
    away = float(np.hypot(miss[0], miss[1])) >= KIDNAP_CARRIED + CARRIED_SHARE * way * (1.0 + 0.5 * angle)
    return away or abs(float(miss[2])) >= CARRIED_TURN + CARRIED_SHARE * angle


def _missed(windows: Windows, i: int, j: int, wheel_track: Track) -> tuple[np.ndarray, np.ndarray]:
    """The motion that the wheels tell from window i to window j, and where j lies as seen from its end."""
    base = se2.interpolate(windows.t[[i, j]], wheel_track.t, wheel_track.pose)
    said = se2.between(base[0], base[1])
    return said, se2.between(se2.compose(windows.place[i], said), windows.place[j])


def _driven(wheel_track: Track, begin: float, end: float) -> tuple[float, float]:
    """The distance [m] and the angle [rad] that wheels tell, to and fro."""
    inside = wheel_track.pose[(wheel_track.t >= begin) & (wheel_track.t <= end)]
    way = np.hypot(*np.diff(inside[:, :2], axis=0).T)
    return float(way.sum()), float(np.abs(se2.wrap_angle(np.diff(inside[:, 2]))).sum())


def _moment(windows: Windows, i: int, j: int, wheel_track: Track, placing: PlacingConfig, blind: float) -> Relocation:
    """The moment between two windows up to which sightings agree with the one, and from which with the other.

    Where long nothing was seen in between, both ends of that time: nobody knows when in it the robot was carried.
    """
    z = windows.seen.select((windows.seen.t > windows.t[i]) & (windows.seen.t < windows.t[j]))
    left, right = float(windows.t[i]), float(windows.t[j])
    if len(z):
        cost = []
        for k in (i, j):
            base = se2.interpolate(windows.t[[k]], wheel_track.t, wheel_track.pose)[0]
            T = se2.compose(windows.place[k], se2.inverse(base))
            cost.append(np.minimum(np.square(residuals(z, T, placing)).sum(axis=-1), PLACING_INLIER**2))
        total = np.append(0.0, np.cumsum(cost[0])) + np.append(np.cumsum(cost[1][::-1])[::-1], 0.0)
        k = int(np.argmin(total))
        left = float(z.t[k - 1]) if k else left
        right = float(z.t[k]) if k < len(z) else right
    return Relocation(left + NEXT, right) if right - left > blind else Relocation(*[0.5 * (left + right)] * 2)


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
    mapper: Mapper,
    join: Joiner,
) -> Cut:
    """The team with every robot's log cut where the robot was put down elsewhere, its map from the longest stretch.

    The robot that fits the team's map worst is looked at first; after each that was carried the rest are judged anew.
    A team in which nobody was comes back as it is. mapper, join: how local maps and their fusion are made.
    """
    whole, main, maps = list(logs), list(logs), list(local)
    cleared: set[str] = set()
    for _ in range(KIDNAP_MOST):
        by = {log.robot: log for log in main}
        suspects = _suspects(maps, fusion, by, placing, smoothing)
        relocated = None
        for robot in suspects:
            k = next(i for i, log in enumerate(main) if log.robot == robot)
            if robot in cleared or main[k] is not logs[k]:
                continue
            moments = _moments(main[k], maps, fusion, placing, smoothing, mapper, join)
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
    cov = np.diag([placing.sure_xy**2, placing.sure_xy**2, SURE_THETA**2])
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
        n = _bad_bins(m, fusion, logs, placing)
        if n >= BAD_BINS or restless or _bent(m.track, log, _calibrated(smoothing, m), BENT_WITHIN) > KIDNAP_BENT:
            bad[m.robot] = n
    return sorted(bad, key=lambda robot: (-bad[robot], in_order(robot)))


def _bad_bins(m: LocalMap, fusion: Fusion, logs: Mapping[str, LandmarkLog], placing: PlacingConfig) -> int:
    """In how many stretches of the log most of what the robot saw lies elsewhere in the largest map."""
    first = fusion.components[0] if fusion.components else None
    if first is None:
        return 0
    if m.robot not in first.robots:
        return int(np.ptp(m.track.t) // KIDNAP_BIN) if len(m.track.t) else 0
    T = first.frames[m.robot]
    own = Body({m.robot: Track(m.track.t, se2.compose(T, m.track.pose))}, {})
    z = mutual_sightings(_landmarks(first.map), own, logs, fusion.labels)
    if not len(z):
        return 0
    agrees = np.square(residuals(z, np.zeros(3), placing)).sum(axis=-1) < PLACING_INLIER**2
    number = ((z.t - z.t.min()) // KIDNAP_BIN).astype(int)
    n, good = np.bincount(number), np.bincount(number, weights=agrees)
    return int(((n >= BIN_SIGHTINGS) & (good < BIN_SHARE * n)).sum())


def _bent(track: Track, log: LandmarkLog, smoothing: SmoothingConfig, span: int) -> float:
    """The most [m] that the track deviates from the wheels within `span` seconds."""
    if log.odometry is None or not len(track.t) or np.ptp(track.t) <= span:
        return 0.0
    t = np.arange(track.t[0], track.t[-1], 1.0)
    known, motion = smoothing.calibration, CommandedMotion.of(log.odometry, MOTION_NOISE_HOLD)
    said, k = motion.at(t, known.speed_scale, known.turn_scale, known.lag)[0], span
    was = se2.interpolate(t, track.t, track.pose)
    miss = se2.between(se2.between(said[:-k], said[k:]), se2.between(was[:-k], was[k:]))
    return float(np.hypot(miss[:, 0], miss[:, 1]).max(initial=0.0))


def _moments(
    log: LandmarkLog,
    maps: Sequence[LocalMap],
    fusion: Fusion,
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
        if own is not None and len(own.submap.ids) >= KIDNAP_LANDMARKS:
            known = _calibrated(smoothing, own)
            reference = _landmarks(own.submap.landmarks)
            relocations = jumps(reference, log, {}, placing, known)
            if relocations and not denied(relocations, reference, log, {}, restless, placing, known):
                return relocations
    others = join([m for m in maps if m.robot != log.robot])
    first = others.components[0] if others.components else None
    if first is None or len(first.robots) < 2 or len(first.map) < KIDNAP_LANDMARKS:
        return ()
    reference = _landmarks(first.map)
    relocations = jumps(reference, log, fusion.labels, placing, smoothing)
    refuted = relocations and denied(relocations, reference, log, fusion.labels, restless, placing, smoothing)
    return () if refuted else relocations


def _calibrated(smoothing: SmoothingConfig, m: LocalMap) -> SmoothingConfig:
    """With the wheels as a map of the robot's own found them."""
    calibration = {name: m.calibration[name][0] for name in ("turn_scale", "lag") if name in m.calibration}
    return replace(smoothing, calibration=replace(smoothing.calibration, **calibration))


def _landmarks(m: LandmarkMap) -> Body:
    return Body({}, dict(zip(m.ids, m.mean, strict=True)))
