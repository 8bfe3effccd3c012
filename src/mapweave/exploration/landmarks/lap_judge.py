"""What a plan of laps costs, in steps: how late the field is seen, and how large the map's error is expected to be.

A plan is judged by driving it without noise, before the first step or from where the robots are by now. Its error
follows from the information in odometry and in landmarks: the known ones, and layouts drawn where nobody has been.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import lapack

from ...kernels.exploration.laps import (
    LandmarkSensor,
    LapRules,
    add_landmark_information,
    drive_laps,
    landmark_errors,
    lap_sightings,
    odometry_information,
    seen_shares,
)
from ...kernels.walls.segments import Raster, Sector
from ...landmarks.submap_slam import SubmapConfig
from .config import LapSearchConfig

Plan = tuple[Float[np.ndarray, "r k 2"], Int[np.ndarray, " r"]]
MEAN_OF_RMS = 0.886  # mean distance over its root mean square, for a round Gaussian


@dataclass(frozen=True)
class LapTask:
    """What a plan is for. steps: when the laps should be done; density: expected landmarks a square metre."""

    lower: tuple[float, float]
    upper: tuple[float, float]
    starts: tuple[tuple[float, float, float], ...]
    controls: tuple[tuple[float, float], ...]
    submap: SubmapConfig
    steps: int
    density: float
    error_weight: float  # steps a metre
    search: LapSearchConfig
    heading_cost: float  # [m/rad], as `steering` has it


@dataclass(frozen=True, slots=True)
class Past:
    """What a team knows under way. trail: poses (M, n, 3) from the start to now; marks: (k, 2) [m] known landmarks.

    explored: cells of the judge's raster; live: who drives on.
    """

    trail: Float[np.ndarray, "r n 3"]
    marks: Float[np.ndarray, "k 2"]
    explored: Bool[np.ndarray, "ny nx"]
    live: Bool[np.ndarray, " r"]


def beginning(task: LapTask) -> Past:
    """Everybody at its start, nothing seen."""
    shape = np.ceil((np.array(task.upper) - task.lower) / task.search.coarse_cell - 1e-9).astype(int)[::-1]
    starts = np.array(task.starts)
    return Past(starts[:, None], np.zeros((0, 2)), np.zeros(shape, dtype=bool), np.ones(len(starts), dtype=bool))


class LapJudge:
    """The cost of a plan, in steps; the map's error is that over `layouts` of landmarks, drawn once."""

    def __init__(self, task: LapTask, layouts: int, past: Past | None = None) -> None:
        self.task, self.past = task, beginning(task) if past is None else past
        self.lower, self.upper = np.array(task.lower), np.array(task.upper)
        self.controls = np.array(task.controls)
        self.step = self.past.trail.shape[1] - 1
        self.here = self.past.trail[:, -1].copy()
        self.movers = np.flatnonzero(self.past.live)
        self.landmarks = max(1, round(task.density * float(np.prod(self.upper - self.lower))))
        self.layouts = np.ascontiguousarray(self._draw(layouts, np.random.default_rng(1)))

    def _draw(self, layouts: int, rng: np.random.Generator) -> np.ndarray:
        """Landmarks (layouts, n, 2): the known ones, and as many as are to be expected where nobody has been."""
        t, known = self.task, self.past.marks
        if not self.past.explored.any():
            return rng.uniform(self.lower, self.upper, size=(layouts, self.landmarks, 2))
        left = np.argwhere(~self.past.explored)[:, ::-1]
        new = round(t.density * len(left) * t.search.coarse_cell**2)
        if new == 0:
            return known[None]
        drawn = rng.uniform(size=(layouts, new, 3))
        cells = left[(drawn[..., 0] * len(left)).astype(np.int64)]
        places = np.minimum(self.lower + (cells + drawn[..., 1:]) * t.search.coarse_cell, self.upper)
        return np.concatenate([np.broadcast_to(known, (layouts, *known.shape)), places], axis=1)

    def __call__(self, plan: Plan, enough: float = np.inf) -> float:
        """Its cost, or something above `enough` when that is sure to be exceeded."""
        t = self.task
        track = self.drive(plan)
        share = self.shares(track)
        missed = self.landmarks * (1.0 - share[-1])
        late = (1.0 - share[max(t.steps - self.step, 0) :] ** self.landmarks).sum()
        cost = float(t.steps + late + t.search.missed_cost * missed)
        if cost > enough:
            return cost
        left = (enough - cost) / t.error_weight if t.error_weight else np.inf
        return cost + t.error_weight * self.error(track, left)

    def drive(self, plan: Plan) -> np.ndarray:
        """Poses (M, n, 3) of a drive without noise from now on, a little longer than the task."""
        t = self.task
        rules = LapRules(self.controls, t.submap.period, self.lower, self.upper, t.search.arrived, t.heading_cost)
        return drive_laps(*plan, self.here, rules, max(t.steps - self.step, 0) + t.search.tail_steps)

    def shares(self, track: np.ndarray) -> np.ndarray:
        """What share of the field is seen by each step of `track`."""
        s, search = self.task.submap, self.task.search
        sector = Sector(s.reach - search.reach_margin, s.half_angle)
        return seen_shares(track, self.past.explored, sector, Raster(self.lower, search.coarse_cell))

    def error(self, track: np.ndarray, enough: float = np.inf) -> float:
        """Mean error [m] expected of the landmarks after the task's steps, over the layouts. track: (M, n, 3) from now.

        Of a plan whose first layouts make it very probable that this is above `enough`, theirs alone, above it too.
        """
        s, search = self.task.submap, self.task.search
        every = search.pose_stride
        nodes = max(self.task.steps, self.step + every) // every
        whole = np.concatenate([self.past.trail[:, :-1], track], axis=1)[:, : nodes * every + 1]
        whole = np.ascontiguousarray(whole)
        sensor = LandmarkSensor(
            Sector(s.reach, s.half_angle),
            s.R,
            search.least_range,
            self.step,
            search.sight_margin,
            max(1, every // search.looks),
        )
        odometry = odometry_information(whole, every, s.Q)
        limits = dict(search.hopeless_by_now if self.step else search.hopeless)
        total = 0.0  # of landmarks seen: those missed are dear already
        for k, marks in enumerate(self.layouts):
            S = odometry.copy()
            sighted = lap_sightings(whole, every, marks, sensor)
            add_landmark_information(S, sighted)
            errors = landmark_errors(_inverse(S), sighted)
            seen = errors[np.isfinite(errors)]
            total += MEAN_OF_RMS * float(seen.mean()) if len(seen) else 0.0
            if total / (k + 1) * limits.get(k + 1, 0.0) > enough:
                return total / (k + 1)
        return total / len(self.layouts)


def _inverse(S: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Of a positive definite S, on and above the diagonal: a third of the work of a general inverse."""
    L, failed = lapack.dpotrf(S.T, lower=1)
    if failed:
        return np.linalg.inv(S)
    P, _ = lapack.dpotri(L, lower=1, overwrite_c=1)
    return np.asarray(P.T)
