"""Laps for a whole team, searched so that the field is seen soon and the map is expected to be sure.

A plan is judged by driving it without noise. Its cost, in steps, is when the last landmark is expected to be seen, and
`error_weight` times the error that the landmarks are expected to have by then, from the information in odometry and
in landmarks of the expected density. That error is small where robots end at ground that one of them saw early.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lapack

from ...kernels.exploration.laps import (
    LandmarkSensor,
    LapRules,
    add_landmark_information,
    drive_laps,
    landmark_errors,
    odometry_information,
    seen_shares,
)
from ...kernels.walls.segments import Raster, Sector
from ...landmarks.submap_slam import SubmapConfig
from .config import LapSearchConfig

Plan = tuple[Float[np.ndarray, "r k 2"], Int[np.ndarray, " r"]]
HOPELESS = ((8, 0.85), (24, 0.92))  # after so many layouts a plan is given up whose error, times this, is too much
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


@lru_cache(maxsize=8)
def find_laps(task: LapTask) -> tuple[tuple[np.ndarray, ...], int]:
    """The places (k, 2) [m] that each robot should pass in turn, and the step at which they show nothing new any more.

    The same for the same task; the step is no sooner than the task's.
    """
    rng, search = np.random.default_rng(0), task.search
    rough, judge, fine = (_Judge(task, n) for n in (search.rough_layouts, search.layouts, search.fine_layouts))
    first = sorted(_first_plans(task), key=rough)[: search.first_plans]
    begun = sorted((_improve(plan, rough, search.tries // 4, rng) for plan in first), key=lambda b: b[0])
    better = [_improve(plan, judge, search.tries, rng) for _, plan in begun[: search.finalists]]
    best = min(better, key=lambda b: b[0])[1]
    _, plan = _improve(best, fine, round(search.fine_share * search.tries), rng, search.fine_heat)
    share = fine.shares(fine.drive(plan))
    end = max(task.steps, int(np.argmax(share >= share[-1])))
    return tuple(w[:n].copy() for w, n in zip(*plan, strict=True)), end


class _Judge:
    """The cost of a plan, in steps; the map's error is that over `layouts` of landmarks, drawn once."""

    def __init__(self, task: LapTask, layouts: int) -> None:
        self.task = task
        self.lower, self.upper = np.array(task.lower), np.array(task.upper)
        self.starts, self.controls = np.array(task.starts), np.array(task.controls)
        nx, ny = np.ceil((self.upper - self.lower) / task.search.coarse_cell - 1e-9).astype(int)
        self.nothing = np.zeros((ny, nx), dtype=bool)
        self.landmarks = max(1, round(task.density * float(np.prod(self.upper - self.lower))))
        rng = np.random.default_rng(1)
        self.layouts = rng.uniform(self.lower, self.upper, size=(layouts, self.landmarks, 2))

    def __call__(self, plan: Plan, enough: float = np.inf) -> float:
        """Its cost, or something above `enough` when that is sure to be exceeded."""
        t = self.task
        track = self.drive(plan)
        share = self.shares(track)
        missed = self.landmarks * (1.0 - share[-1])
        cost = float(t.steps + (1.0 - share[t.steps :] ** self.landmarks).sum() + t.search.missed_cost * missed)
        if cost > enough:
            return cost
        judged = track[:, : t.steps // t.search.pose_stride * t.search.pose_stride + 1]
        left = (enough - cost) / t.error_weight if t.error_weight else np.inf
        return cost + t.error_weight * self.error(judged, left)

    def drive(self, plan: Plan) -> np.ndarray:
        """Poses (M, n, 3) of a drive without noise, a little longer than the task."""
        t = self.task
        rules = LapRules(self.controls, t.submap.period, self.lower, self.upper, t.search.arrived, t.heading_cost)
        return drive_laps(*plan, self.starts, rules, t.steps + t.search.tail_steps)

    def shares(self, track: np.ndarray) -> np.ndarray:
        """What share of the field is seen by each step of `track`."""
        s, search = self.task.submap, self.task.search
        sector = Sector(s.reach - search.reach_margin, s.half_angle)
        return seen_shares(track, self.nothing, sector, Raster(self.lower, search.coarse_cell))

    def error(self, track: np.ndarray, enough: float = np.inf) -> float:
        """Mean error [m] expected of the landmarks along `track` (M, n, 3), over the layouts.

        Of a plan whose first layouts make it very probable that this is above `enough`, theirs alone, above it too.
        """
        s, every = self.task.submap, self.task.search.pose_stride
        sensor = LandmarkSensor(Sector(s.reach, s.half_angle), s.R, self.task.search.least_range)
        track = np.ascontiguousarray(track)
        odometry = odometry_information(track, every, s.Q)
        limits = dict(HOPELESS)
        total = 0.0  # of landmarks seen: those missed are dear already
        for k, marks in enumerate(self.layouts):
            S = odometry.copy()
            add_landmark_information(S, track, every, marks, 1.0, sensor)
            total += MEAN_OF_RMS * float(np.nanmean(landmark_errors(_inverse(S), track, every, marks, sensor)))
            if total / (k + 1) * limits.get(k + 1, 0.0) > enough:
                return total / (k + 1)
        return total / len(self.layouts)


def _inverse(S: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Of a positive definite S: half the work of a general inverse."""
    L, failed = lapack.dpotrf(S.T, lower=1)
    if failed:
        return np.linalg.inv(S)
    P, _ = lapack.dpotri(L, lower=1, overwrite_c=1)
    return np.asarray(np.tril(P) + np.tril(P, -1).T)


def _first_plans(task: LapTask) -> list[Plan]:
    """Out to a ring along the border and round a share of it or somewhat more, then home.

    All robots alike, from eight sides, both ways.
    """
    lower, upper, starts = np.array(task.lower), np.array(task.upper), np.array(task.starts)
    around = starts[:, :2] - starts[:, :2].mean(axis=0)
    place = np.argsort(np.argsort(np.arctan2(around[:, 1], around[:, 0])))
    plans, search = [], task.search
    share = 2 * np.pi / len(starts)
    for turn in (share, -share, search.overlap * share, -search.overlap * share):
        for first in np.arange(8) * np.pi / 4:
            ways, counts = np.zeros((len(starts), search.most_places, 2)), np.zeros(len(starts), dtype=np.int64)
            for j, k in enumerate(place):
                lap = [*_on_the_ring(lower, upper, first + share * k, turn, search.border), starts[j, :2]]
                ways[j, : len(lap)], counts[j] = lap, len(lap)
            plans.append((ways, counts))
    return plans


def _on_the_ring(lower: np.ndarray, upper: np.ndarray, begin: float, turn: float, border: float) -> list[np.ndarray]:
    """Places from direction `begin` of the middle through `turn` [rad], its corners among them, `border` [m] inside."""
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    half = np.maximum(half - border, 0.5 * half)
    corner = np.arctan2(half[1], half[0]) * np.array([1.0, -1.0, 1.0, -1.0]) + np.array([0.0, 0.0, np.pi, np.pi])
    past = np.mod(np.sign(turn) * (corner - begin), 2 * np.pi)
    between = np.sort(past[past < abs(turn)])
    angles = begin + np.sign(turn) * np.concatenate([[0.0], between, [abs(turn)]])
    out = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return list(middle + out / np.max(np.abs(out) / half, axis=1, keepdims=True))


def _improve(plan: Plan, judge: _Judge, tries: int, rng: np.random.Generator, heat: float = 1.0) -> tuple[float, Plan]:
    """The best plan met on a walk of small changes that cools down, and its cost. heat: with which it begins."""
    now = best = judge(plan)
    best_plan = plan
    for k in range(tries):
        left = heat * (1.0 - k / tries)
        other = _changed(plan, judge.lower, judge.upper, 1.0 + 8.0 * left, rng)
        bound = now - 2.0 * left * np.log(rng.random())
        cost = judge(other, bound)
        if cost < bound:
            plan, now = other, cost
            if now < best:
                best, best_plan = now, plan
    return best, best_plan


def _changed(plan: Plan, lower: np.ndarray, upper: np.ndarray, size: float, rng: np.random.Generator) -> Plan:
    """One place of one robot moved by about `size` [m], left out or put in, or a stretch of its lap turned round."""
    ways, counts = plan[0].copy(), plan[1].copy()
    j = int(rng.integers(len(counts)))
    way, n, what = ways[j], int(counts[j]), rng.random()
    if what < 0.7 and n:
        k = int(rng.integers(n))
        way[k] = np.clip(way[k] + size * rng.normal(size=2), lower, upper)
    elif what < 0.8 and n > 1:
        k = int(rng.integers(n))
        way[k : n - 1] = way[k + 1 : n].copy()
        counts[j] = n - 1
    elif what < 0.9 and n < len(way):
        k = int(rng.integers(n + 1))
        middle = 0.5 * (way[max(k - 1, 0)] + way[min(k, n - 1)]) if n else 0.5 * (lower + upper)
        way[k + 1 : n + 1] = way[k:n].copy()
        way[k] = np.clip(middle + size * rng.normal(size=2), lower, upper)
        counts[j] = n + 1
    elif n > 1:
        a, b = np.sort(rng.integers(0, n, size=2))
        way[a : b + 1] = way[a : b + 1][::-1].copy()
    return ways, counts
