"""Simulated teams with receivers: two robots among landmarks, anywhere on earth, and what is true of them there."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mapweave.api.map_landmarks import map_landmark_logs
from mapweave.api.map_options import MapOptions
from mapweave.api.team import TeamResult
from mapweave.core import se2
from mapweave.core.fixes import Fixes, enu_of, place_of
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.mapping.woven_map import Georeference
from mapweave.ranges.estimate import RangeEstimate, estimate
from mapweave.ranges.network import RangeLog, RangeNetwork, network_of, steps
from mapweave.sim.laser import DATUM, placed, simulated_fixes
from mapweave.sim.mixed_team import MixedWorld, simulate_mixed
from mapweave.team.georeference import LaidRanges, laid_ranges
from mapweave.team.smooth import Smoothed

from ..ranges.worlds import log_of
from .teams import world


@dataclass(frozen=True)
class Fixed:
    """logs: without fixes; truth: of each robot, landmarks: east and north of the simulators' datum."""

    logs: tuple[LandmarkLog, ...]
    truth: dict[str, Track]
    landmarks: dict[str, np.ndarray]

    def fixes(self, sd: float, seed: int) -> dict[str, Fixes]:
        return receivers(self.truth, sd, seed)

    def mapped(self) -> TeamResult:
        return map_landmark_logs(self.logs, MapOptions(), "without fixes")


@cache
def fixed(seed: int, first: int = 1, minutes: float = 2.0) -> Fixed:
    """Robots from `first` on, whose landmarks nobody else knows by these names."""
    made = world(seed, robots=2, minutes=minutes)
    names = {log.robot: f"robot{log.number + first - 1}" for log in made.logs}

    def named(table: SightingTable) -> SightingTable:
        return replace(table, ids=tuple(names.get(name, f"{first}-{name}") for name in table.ids))

    logs = tuple(
        replace(log, robot=names[log.robot], sightings=named(log.sightings), bearings=named(log.bearings), log_hash="")
        for log in made.logs
    )
    T, survey = placed(np.random.default_rng(seed)), made.truth.survey
    landmarks = {f"{first}-{n}": at for n, at in zip(survey.ids, se2.act(T, np.asarray(survey.xy)), strict=True)}
    return Fixed(logs, anywhere({names[r]: truth.track for r, truth in made.truth.robots.items()}, seed), landmarks)


@dataclass(frozen=True)
class Ranged:
    """A team with radios, what ranges alone make of it, and where it drove, east and north of the simulators' datum."""

    log: RangeLog
    net: RangeNetwork
    found: RangeEstimate
    truth: dict[str, Track]

    @classmethod
    def of(cls, log: RangeLog, truth: dict[str, Track]) -> "Ranged":
        net = network_of(log)
        return cls(log, net, estimate(net), truth)

    def laid(self, fixes: dict[str, Fixes]) -> LaidRanges:
        return laid_ranges(self.net, self.found, self.log.odometry, fixes)


@cache
def with_radios(seed: int, robots: int = 3, beacons: int = 2, minutes: float = 1.0, *, believed: bool = True) -> Ranged:
    """A tenth of the ranges goes round something; believed: odometry errs as the estimator believes, else as simulated.

    Simulated wheels err several times less than those of real robots, which the estimator's belief is of.
    """
    kinds = {"ranges": True, "lasers": robots, "cameras": 0, "bearings": 0, "beacons": beacons, "nlos": 0.1}
    team = simulate_mixed(MixedWorld(**kinds, minutes=minutes), seed)
    log = log_of(team)
    if believed:
        ways = {robot.name: robot.truth for robot in team.robots}
        log = replace(
            log, odometry={r: _erring(o, ways[r], 10 * seed + k) for k, (r, o) in enumerate(log.odometry.items())}
        )
    return Ranged.of(log, anywhere({robot.name: robot.truth for robot in team.robots}, seed))


def _erring(odometry: Track, truth: Track, seed: int) -> Track:
    """Odometry at the same stamps that errs as it is believed to."""
    rng, inside = np.random.default_rng(seed), odometry.t <= truth.t[-1]
    t = odometry.t[inside]
    true = se2.interpolate(t, truth.t, truth.pose)
    z, cov = steps(true, t)
    z = se2.compose(z, np.sqrt(cov) * rng.standard_normal((len(z), 3)))
    pose = [np.zeros(3)]
    for step in z:
        pose.append(np.asarray(se2.compose(pose[-1], step)))
    return Track(t, np.array(pose), frame=odometry.frame)


def carrying(logs: Iterable[LandmarkLog], fixes: dict[str, Fixes]) -> tuple[LandmarkLog, ...]:
    return tuple(replace(log, fixes=fixes.get(log.robot)) for log in logs)


def alone(log: LandmarkLog) -> LandmarkLog:
    """The log without sightings of robots."""

    def kept(table: SightingTable) -> SightingTable:
        return table.select(np.array([not name.startswith("robot") for name in table.ids], bool)[table.what])

    return replace(log, sightings=kept(log.sightings), bearings=kept(log.bearings))


def from_datum(g: Georeference, xy: np.ndarray) -> np.ndarray:
    """Points of the world that `g` tells of, east and north of the simulators' datum."""
    return enu_of(place_of(np.column_stack([xy, np.zeros(len(xy))]), g.datum), DATUM)[:, :2]


def body_nees(made: Smoothed, landmarks: dict[str, np.ndarray]) -> float:
    """Of where the map's landmarks lie in the world as one body, by its three degrees of freedom."""
    g, ours = made.georeference, made.map.landmarks
    there = from_datum(g, se2.act(g.T_world_map, ours.mean))
    true = np.array([landmarks[name] for name in ours.ids])
    origin = from_datum(g, g.T_world_map[None, :2])[0]
    off = se2.align(true - origin, there - origin)
    return float(off @ np.linalg.solve(g.cov, off) / 3)


def errors(g: Georeference, truth: dict[str, Track], every: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) of every so manyth pose in the world, east and north of the simulators' datum, and n covariances."""
    e, cov = [], []
    for robot, track in g.tracks.items():
        true = truth[robot]
        rows = np.flatnonzero((track.t >= true.t[0]) & (track.t <= true.t[-1]))[::every]
        pose = track.pose[rows].copy()
        pose[:, :2] = from_datum(g, pose[:, :2])
        off = pose - se2.interpolate(track.t[rows], true.t, true.pose)
        off[:, 2] = se2.wrap_angle(off[:, 2])
        e.append(off)
        cov.append(track.cov[rows])
    return np.concatenate(e), np.concatenate(cov)


def nees(g: Georeference, truth: dict[str, Track]) -> float:
    """Of poses in the world, by their degrees of freedom."""
    e, cov = errors(g, truth)
    return float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(cov), e).mean() / 3)


def anywhere(truth: dict[str, Track], seed: int) -> dict[str, Track]:
    """A team's true ways, where a seed puts the team on earth."""
    T = placed(np.random.default_rng(seed))
    return {robot: Track(way.t, np.asarray(se2.compose(T, way.pose))) for robot, way in truth.items()}


def receivers(truth: dict[str, Track], sd: float, seed: int) -> dict[str, Fixes]:
    rng = np.random.default_rng(seed)
    return {robot: simulated_fixes(track, sd, rng) for robot, track in truth.items()}
