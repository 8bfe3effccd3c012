"""Simulated teams with receivers: two robots among landmarks, anywhere on earth, and what is true of them there."""

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
from mapweave.sim.laser import DATUM, placed, simulated_fixes

from .teams import world


@dataclass(frozen=True)
class Fixed:
    """logs: without fixes; truth: of each robot, east and north of the simulators' datum."""

    logs: tuple[LandmarkLog, ...]
    truth: dict[str, Track]

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
    return Fixed(logs, anywhere({names[r]: truth.track for r, truth in made.truth.robots.items()}, seed))


def carrying(logs: tuple[LandmarkLog, ...], fixes: dict[str, Fixes]) -> tuple[LandmarkLog, ...]:
    return tuple(replace(log, fixes=fixes.get(log.robot)) for log in logs)


def errors(g: Georeference, truth: dict[str, Track], every: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) of every so manyth pose in the world, east and north of the simulators' datum, and n covariances."""
    e, cov = [], []
    for robot, track in g.tracks.items():
        true = truth[robot]
        rows = np.flatnonzero((track.t >= true.t[0]) & (track.t <= true.t[-1]))[::every]
        pose = track.pose[rows].copy()
        flat = np.column_stack([pose[:, :2], np.zeros(len(pose))])
        pose[:, :2] = enu_of(place_of(flat, g.datum), DATUM)[:, :2]
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
