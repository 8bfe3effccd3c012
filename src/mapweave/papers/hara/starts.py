"""Localisation with intensity against geometry: starts searched everywhere, in the paper's ring and beyond it.

A log is a piece of a drive of its own, along the way the map was made on or against it, with wheels and noise of its
own. Of every ten logs one is of another building of the same kind, and one of a twin: the same walls, painted and
furnished otherwise, which geometry alone cannot tell apart. An answer is wrong when half of its poses since the start
was found are off by over WRONG; in another building, and with intensity in a twin, every trusted answer is wrong.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...core import se2
from ...core.laser_log import LaserLog
from ...core.records import Track
from ...core.workers import Progress, no_progress
from ...laser.beam import IntensityCalibration, beams
from ...laser.laser_map import GridMap
from ...laser.localise import Localisation, localise
from ...laser.occupancy_mapper import render
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import choose_feature
from ...report.result import Rows
from ...sim.laser import LaserSimulation, LaserWorld, Route, drive, ring
from ...sim.laser_worlds import (
    CorridorConfig,
    OfficeConfig,
    TunnelConfig,
    corridor_world,
    office_route,
    office_world,
    tunnel_route,
    tunnel_world,
)

Kind = Literal["ring", "office", "tunnel"]
Where = Literal["here", "twin", "other"]
Answer = Literal["right", "wrong", "not sure"]
KINDS: tuple[Kind, ...] = ("ring", "office", "tunnel")
FEATURES = {"normalised": "intensity", "none": "geometry"}
WRONG = 0.5  # [m]
SCANS = 60  # of a log
CFG = LaserConfig()


@dataclass(frozen=True, slots=True)
class LocalisedStart:
    """What became of one start. error: [m] of a log of the mapped building, else None; doubt: the reason given."""

    start: int
    world: Kind
    where: Where
    feature: str
    answer: Answer
    error: float | None
    matched: float
    found: bool
    doubt: str


@dataclass(frozen=True, slots=True)
class _Place:
    """A finished map in the world's frame, and what drives through it are made of."""

    grid: GridMap
    calibration: IntensityCalibration | None
    world: LaserWorld
    route: Route


def try_starts(
    starts: int,
    seed: int,
    scans: int = SCANS,
    loop: CorridorConfig | None = None,
    on_progress: Progress = no_progress,
) -> tuple[LocalisedStart, ...]:
    """`starts` logs of `scans` scans located with intensity and without, the buildings in turn.

    loop: the ring instead of the paper's, the only building then. The same seed gives the same answers.
    """
    kinds = KINDS if loop is None else KINDS[:1]
    corridor = loop or CorridorConfig()
    places = {kind: _mapped(kind, corridor) for kind in kinds[: max(starts, 0)]}
    out: list[LocalisedStart] = []
    for k in range(starts):
        on_progress("starts", k, starts)
        out += _tried(k, seed, scans, places, corridor)
    return tuple(out)


def starts_table(starts: Sequence[LocalisedStart]) -> Rows:
    """Head and rows: answers by building and feature, and over all buildings."""
    head = ("world", "map and scans of", "log of", "right", "wrong", "not sure")
    rows: list[tuple[object, ...]] = []
    for kind in (*KINDS, None):
        for feature, name in FEATURES.items():
            for where in ("here", "twin", "other"):
                mine = [s for s in starts if s.world == (kind or s.world) and (s.feature, s.where) == (feature, where)]
                if mine:
                    n = counts(mine)
                    place = {"here": "the building", "twin": "its twin", "other": "another"}[where]
                    rows.append((kind or "all", name, place, n["right"], n["wrong"], n["not sure"]))
    return head, rows


def counts(starts: Sequence[LocalisedStart], feature: str | None = None) -> Counter[str]:
    """How often each answer was given, with one feature or all."""
    return Counter(s.answer for s in starts if feature in {None, s.feature})


def building(kind: Kind, seed: int, change: float, corridor: CorridorConfig) -> tuple[LaserWorld, Route]:
    """A building and a way through it. change: [m] by which its rooms and corridors are wider and longer."""
    if kind == "ring":
        share = min(corridor.long_leg / 60.0, 1.0)
        c = replace(
            corridor,
            width=corridor.width + 0.3 * change,
            long_leg=corridor.long_leg - 6 * share * change,
            short_leg=corridor.short_leg + 4 * share * change,
        )
        return corridor_world(c, seed), ring(c.long_leg, c.short_leg, c.corner, c.distance, c.start)
    if kind == "office":
        o = OfficeConfig()
        o = replace(o, room_width=o.room_width + change, room_depth=o.room_depth - 0.6 * change)
        return office_world(o, seed), office_route(o, seed)
    t = TunnelConfig()
    t = replace(t, width=t.width + 0.5 * change)
    return tunnel_world(t, seed), tunnel_route(t)


def _mapped(kind: Kind, corridor: CorridorConfig) -> _Place:
    """The map of one drive, every scan where it truly was."""
    world, route = building(kind, 1, 0.0, corridor)
    sim = drive(world, route, corridor.drive, 1)
    log = sim.log
    feature = choose_feature(log, CFG)
    seen = [beams(scan, feature.name, feature.calibration, CFG.beam) for scan in log.scans]
    truth = sim.truth.pose[np.searchsorted(sim.truth.t, log.scan_t)]
    sensors = np.array([scan.T_robot_sensor for scan in log.scans])
    return _Place(render(seen, truth, sensors, CFG.resolution, "map"), feature.calibration, world, route)


def _backwards(route: Route) -> Route:
    """The same way the other way round."""
    end = route.poses(np.array([route.total - 1e-6]))[0]
    start = se2.compose(end, np.array([0.0, 0.0, np.pi]))
    return Route(start, route.length[::-1].copy(), -route.curvature[::-1])


def _piece(sim: LaserSimulation, first: int, scans: int) -> tuple[LaserLog, Track]:
    """So many scans of the drive from `first` on, and the truth."""
    log, end = sim.log, min(first + scans, len(sim.log.scans))
    t0, t1 = log.scan_t[first], log.scan_t[end - 1]
    rows = None
    if log.odometry is not None:
        keep = (log.odometry.t >= t0) & (log.odometry.t <= t1)
        rows = Track(log.odometry.t[keep], log.odometry.pose[keep], frame="odom")
    return replace(log, scan_t=log.scan_t[first:end], scans=log.scans[first:end], odometry=rows), sim.truth


def _off(localisation: Localisation, truth: Track) -> float:
    """[m] median error of the poses since the start was found."""
    since = localisation.track.t[0] if localisation.found_t is None else localisation.found_t
    inside = localisation.track.t >= since
    true = truth.pose[np.searchsorted(truth.t, localisation.track.t[inside])]
    return float(np.median(np.hypot(*(localisation.track.pose[inside] - true)[:, :2].T)))


def _tried(k: int, seed: int, scans: int, places: dict[Kind, _Place], corridor: CorridorConfig) -> list[LocalisedStart]:
    """What became of the k-th start, with intensity and without."""
    kind = list(places)[k % len(places)]
    rng = np.random.default_rng([seed, k])
    where: Where = "twin" if k % 10 == 4 else "other" if k % 10 == 9 else "here"
    place = places[kind]
    world, route = place.world, place.route
    if where != "here":
        change = 0.0 if where == "twin" else float(rng.choice([-1.0, 1.0]))
        world, route = building(kind, 1000 + k, change, corridor)
    way = _backwards(route) if rng.random() < 0.5 else route
    sim = drive(world, way, corridor.drive, 5000 + 31 * seed + k)
    log, truth = _piece(sim, int(rng.integers(0, max(1, len(sim.log.scans) - scans))), scans)
    out = []
    for feature in FEATURES:
        if where == "twin" and feature == "none":
            continue
        chance = np.random.default_rng(k)
        localisation = localise(log, place.grid, place.calibration, feature, CFG, None, chance, no_progress)
        error = _off(localisation, truth) if where == "here" else None
        right = error is not None and error < WRONG
        answer: Answer = "not sure" if not localisation.trusted else "right" if right else "wrong"
        out.append(
            LocalisedStart(
                k,
                kind,
                where,
                feature,
                answer,
                error,
                localisation.matched,
                localisation.found_t is not None,
                localisation.doubt,
            )
        )
    return out
