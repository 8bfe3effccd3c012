"""Logs that only another one shows to be wrong: a mirror image of the others, one of another scale, one log twice.

A robot whose bearings and turns have the wrong sign makes a map that fits itself perfectly. Where landmarks agree
clearly better with one of two maps mirrored than with both as they are, one of the two is a mirror image; the few
against the many are.

A copy may be shifted in time, without its own robot's sightings, or a part of the other. Two robots never measure the
same numbers twice in a row. So pairs of successive sightings that two logs both hold, to the bit, tell a copy; a copy
counts once, as the same file given twice does.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.names import in_order
from ..core.records import Odometry
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .alignment import align_robust

MIRROR_LANDMARKS = 6  # in common, from which two maps are compared

MIRROR_AGREE = 0.7  # share of them that must agree mirrored,
MIRROR_FEWER = 0.6  # and of those how many at most may as they are
MIRROR_GATE = 0.5  # [m] within which a landmark agrees

SCALE_LANDMARKS = 4  # in common, from which scales are compared
SCALE_RATIO = 1.15  # from which one of two maps is in another unit, or its wheels and camera are not calibrated,
SCALE_OFF = 0.5  # if the landmarks' root mean square distance from their middle differs by so much [m],
SCALE_SURE = 5.0  # and by so many standard deviations, as landmarks scatter about the other map made as large

COPIES_PAIRS = 20  # successive pairs of sightings of the shorter log, from which logs are compared
COPIES_SHARE = 0.5  # of them that the other must hold too
COPIES_VARIED = 0.5  # share of a log's pairs that must differ from each other: constant numbers prove nothing


def mirror_images(maps: Sequence[LocalMap]) -> tuple[str, ...]:
    """Robots whose maps are mirror images of those of more others; none where as many stand against as many."""
    landmarks = [m.submap.landmarks for m in maps]
    side = {(i, k): _side(landmarks[i], landmarks[k]) for i in range(len(maps)) for k in range(i)}
    hand: dict[int, int] = {}
    out: list[str] = []
    for start in range(len(maps)):
        if start in hand:
            continue
        hand[start], group = 1, [start]
        for i in group:
            for k in range(len(maps)):
                same = side.get((max(i, k), min(i, k)), 0)
                if k not in hand and same:
                    hand[k] = same * hand[i]
                    group.append(k)
        many = int(np.sign(sum(hand[k] for k in group)))
        out += [maps[k].robot for k in group if hand[k] == -many]
    return tuple(sorted(out, key=in_order))


def unmirrored(log: LandmarkLog) -> LandmarkLog:
    """The log with bearings and turns of the other sign, and a finding."""
    wheels = log.odometry
    found = Finding("map-mirrored", log.robot, action="its bearings and turns are taken with the other sign")
    return replace(
        log,
        sightings=_other_side(log.sightings),
        bearings=_other_side(log.bearings),
        odometry=None if wheels is None else Odometry(wheels.t, wheels.v, -wheels.w),
        findings=(*log.findings, found),
    )


def _other_side(seen: SightingTable) -> SightingTable:
    return replace(seen, bearing=-seen.bearing)


def _side(a: LandmarkMap, b: LandmarkMap) -> int:
    there = set(b.ids)
    shared = [name for name in a.ids if name in there]
    if len(shared) < MIRROR_LANDMARKS:
        return 0
    p, q, gate = a.select(shared).mean, b.select(shared).mean, np.full(len(shared), MIRROR_GATE)
    fits = [int(align_robust(x, q, gate).inliers.sum()) for x in (p, p * np.array([1.0, -1.0]))]
    if max(fits) < MIRROR_AGREE * len(shared) or min(fits) > MIRROR_FEWER * max(fits):
        return 0
    return 1 if fits[0] > fits[1] else -1


def scales_apart(maps: Sequence[LocalMap], components: Sequence[Sequence[str]]) -> tuple[Finding, ...]:
    """A finding of each component (its robots) in which two maps tell the same landmarks clearly farther apart.

    Joined they fit: how large a map is, is what its own robot knows least, and their middle is as wrong as both.
    """
    found = []
    for robots in components:
        own = [m for m in maps if m.robot in robots]
        told = [
            (_scale(a.submap.landmarks, b.submap.landmarks), a.robot, b.robot)
            for k, b in enumerate(own)
            for a in own[:k]
        ]
        ratio, a, b = max(((max(s, 1.0 / s), a, b) for s, a, b in told), default=(1.0, "", ""))
        if ratio > SCALE_RATIO:
            found.append(Finding("maps-scales", value={"pair": f"{a} and {b}", "value": 100.0 * (ratio - 1.0)}))
    return tuple(found)


def _scale(a: LandmarkMap, b: LandmarkMap) -> float:
    """How many times farther apart the landmarks of both lie in b than in a; 1 where that is not clear."""
    there = set(b.ids)
    shared = [name for name in a.ids if name in there]
    if len(shared) < SCALE_LANDMARKS:
        return 1.0
    p, q = (m.select(shared).mean for m in (a, b))
    p, q = p - p.mean(axis=0), q - q.mean(axis=0)
    size_p, size_q = (float(np.sqrt(np.square(x).sum(axis=1).mean())) for x in (p, q))
    if abs(size_p - size_q) < SCALE_OFF or min(size_p, size_q) <= 0.0:
        return 1.0
    scale = size_q / size_p
    scatter = np.sqrt(np.square(se2.act(se2.align(scale * p, q), scale * p) - q).sum(axis=1).mean())
    sure = abs(size_p - size_q) > SCALE_SURE * scatter / np.sqrt(len(shared))
    return scale if sure else 1.0


def with_copies_marked(logs: Sequence[LandmarkLog]) -> list[LandmarkLog]:
    """The logs in their order; one that repeats an earlier one carries its hash and a finding."""
    same = _same([_successive(log) for log in logs])
    known: list[LandmarkLog] = []
    for k, log in enumerate(logs):
        first = next(iter(np.flatnonzero(same[k, :k]).tolist()), None)
        if first is None or known[first].log_hash == log.log_hash:
            known.append(log)
            continue
        found = Finding("log-twice", log.robot, value=logs[first].robot, action="counted once")
        known.append(replace(log, log_hash=known[first].log_hash, findings=(*log.findings, found)))
    return known


def _successive(log: LandmarkLog) -> Float[np.ndarray, "n 4"]:
    """Range and bearing of every sighting and of the next, each such pair once; none where most repeat others."""
    tables = [s for s in (log.sightings, log.bearings) if len(s)]
    rows = [np.column_stack([np.nan_to_num(s.range), s.bearing]) for s in tables]
    pairs = np.concatenate([np.zeros((0, 4)), *(np.hstack([r[:-1], r[1:]]) for r in rows)])
    once = np.unique(pairs, axis=0)
    return once if len(once) >= COPIES_VARIED * len(pairs) else np.zeros((0, 4))


def _same(pairs: Sequence[Float[np.ndarray, "_ 4"]]) -> Bool[np.ndarray, "m m"]:
    """Of each of m logs and each other whether they hold the same; pairs: of each, every one once."""
    count = np.array([len(p) for p in pairs], dtype=np.int64)
    which = np.unique(np.concatenate([np.zeros((0, 4)), *pairs]), axis=0, return_inverse=True)[1].ravel()
    log = np.repeat(np.arange(len(pairs)), count)
    holds = sp.csr_array((np.ones(len(log)), (log, which)), shape=(len(pairs), int(which.max(initial=-1)) + 1))
    least = np.minimum.outer(count, count)
    return np.asarray((least >= COPIES_PAIRS) & ((holds @ holds.T).toarray() >= COPIES_SHARE * least))
