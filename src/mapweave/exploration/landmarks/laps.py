"""Laps for a whole team: how good they are expected to be, the search among them, and how they are driven."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import lapack

from ...core import se2
from ...kernels.exploration.objective import (
    LandmarkSensor,
    LapRules,
    add_landmark_information,
    drive_laps,
    landmark_errors,
    lap_sightings,
    mark_half_disc,
    odometry_information,
    seen_shares,
)
from ...kernels.walls.segments import Raster, Sector
from ...landmarks.submap_slam import SubmapConfig
from .belief import LandmarkBelief
from .config import STEERING_HEADING_COST, CoverageConfig, ExploreConfig, JointConfig, LapSearchConfig
from .objective import steer

COVERAGE_LOOKS = 4  # for each pose of a lap of `coverage`: every third step of it,
COVERAGE_SIGHT_MARGIN = 0.7  # [m] and landmarks are not counted on at the end of the reach
LAPS_FIRST_PLANS = 4  # plans that are improved a little before the best of them are chosen
LAPS_FINALISTS = 2  # of those that are improved further before one is chosen
LAPS_FINE_SHARE = 0.4  # of the tries that the chosen one gets once more, judged on more layouts
LAPS_FINE_HEAT = 0.25  # of the heat with which that begins: it refines and does not wander off
LAPS_MOST_PLACES = 12  # of a lap: more make the search slower and the laps no better
LAPS_ARRIVED = 5.0  # [m] from a place at which it is reached: cutting corners costs no coverage within the reach
LAPS_BORDER = 12.0  # [m] from the border at which the first plans' ring lies, a little less than the reach
LAPS_OVERLAP = 1.2  # of its share of the ring that a robot may go round, on into the next one's
LAPS_REVISITS = 0.3  # of the changes tried under way that send a robot by a known landmark
LAPS_TAIL_STEPS = 40  # [steps] of driving judged beyond the laps: what repair takes where something is left
LAPS_MISSED_COST = 10.0  # [steps] for each landmark that the laps are expected to miss
LAPS_REACH_MARGIN = 0.7  # [m] of the reach not counted on: the true drive will differ a little
LAPS_POSE_STRIDE = 12  # [steps] between the poses that carry the information
LAPS_LEAST_RANGE = 2.0  # [m], sightings from nearer are not counted on to tell more
LAPS_ROUGH_LAYOUTS = 8  # of landmarks on which the map's error of first plans is judged
LAPS_LAYOUTS = 24  # the same of the finalists: on 8 the best plan is the one that suits just these
LAPS_FINE_LAYOUTS = 96  # the same of the chosen one
LAPS_LAYOUTS_BY_NOW = 4  # on which a plan is judged under way, when most landmarks are known
LAPS_HOPELESS = ((8, 0.85), (24, 0.92))  # after so many a plan is given up whose error, times this, is too much
LAPS_HOPELESS_BY_NOW = ((1, 0.85), (2, 0.9), (4, 0.94))  # the same under way, when layouts share what is known
COVERAGE_REVISE_FROM = 40  # [steps] before which too little is known to change tours for
COVERAGE_REVISE_EVERY = 10  # [steps] between changes: a robot has seen new ground as deep as half its reach by then
COVERAGE_SURE_MARGIN = 0.7  # [m] by which a cell must be within the reach to count as seen when tours are changed
COVERAGE_SAME_LANDMARK = 3.0  # [m] within which two landmarks count as one when tours are changed

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
    looks: int  # that are counted for each pose that carries information, evenly spread around it
    sight_margin: float  # [m] of the reach in which landmarks are not counted on to be seen


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
        cost = float(t.steps + late + LAPS_MISSED_COST * missed)
        if cost > enough:
            return cost
        left = (enough - cost) / t.error_weight if t.error_weight else np.inf
        return cost + t.error_weight * self.error(track, left)

    def drive(self, plan: Plan) -> np.ndarray:
        """Poses (M, n, 3) of a drive without noise from now on, a little longer than the task."""
        t = self.task
        rules = LapRules(self.controls, t.submap.period, self.lower, self.upper, LAPS_ARRIVED, STEERING_HEADING_COST)
        return drive_laps(*plan, self.here, rules, max(t.steps - self.step, 0) + LAPS_TAIL_STEPS)

    def shares(self, track: np.ndarray) -> np.ndarray:
        """What share of the field is seen by each step of `track`."""
        s, search = self.task.submap, self.task.search
        sector = Sector(s.reach - LAPS_REACH_MARGIN, s.half_angle)
        return seen_shares(track, self.past.explored, sector, Raster(self.lower, search.coarse_cell))

    def error(self, track: np.ndarray, enough: float = np.inf) -> float:
        """Mean error [m] expected of the landmarks after the task's steps, over the layouts. track: (M, n, 3) from now.

        Of a plan whose first layouts make it very probable that this is above `enough`, theirs alone, above it too.
        """
        s = self.task.submap
        every = LAPS_POSE_STRIDE
        nodes = max(self.task.steps, self.step + every) // every
        whole = np.concatenate([self.past.trail[:, :-1], track], axis=1)[:, : nodes * every + 1]
        whole = np.ascontiguousarray(whole)
        sensor = LandmarkSensor(
            Sector(s.reach, s.half_angle),
            s.R,
            LAPS_LEAST_RANGE,
            self.step,
            self.task.sight_margin,
            max(1, every // self.task.looks),
        )
        odometry = odometry_information(whole, every, s.Q)
        limits = dict(LAPS_HOPELESS_BY_NOW if self.step else LAPS_HOPELESS)
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


Laps = tuple[Float[np.ndarray, "_ 2"], ...]  # the places that each robot should pass in turn


@lru_cache(maxsize=8)
def find_laps(task: LapTask) -> tuple[Laps, int]:
    """The laps for a task that begins, and the step at which they show nothing new any more.

    The same for the same task; the step is no sooner than the task's.
    """
    rng, search = np.random.default_rng(0), task.search
    rough, judge, fine = (LapJudge(task, n) for n in (LAPS_ROUGH_LAYOUTS, LAPS_LAYOUTS, LAPS_FINE_LAYOUTS))
    first = sorted(_first_plans(task), key=rough)[:LAPS_FIRST_PLANS]
    begun = sorted((_improve(plan, rough, search.tries // 4, rng) for plan in first), key=lambda b: b[0])
    better = [_improve(plan, judge, search.tries, rng) for _, plan in begun[:LAPS_FINALISTS]]
    best = min(better, key=lambda b: b[0])[1]
    _, plan = _improve(best, fine, round(LAPS_FINE_SHARE * search.tries), rng, LAPS_FINE_HEAT)
    return _laps(plan), _end(plan, fine)


@lru_cache(maxsize=8)
def improve_tours(task: LapTask, tours: tuple[tuple[tuple[float, float], ...], ...]) -> tuple[Laps, int]:
    """Tours of places [m] made laps for a task that begins, and the step at which they show nothing new any more."""
    judge = LapJudge(task, LAPS_LAYOUTS)
    plan = _plan([np.array(tour).reshape(-1, 2) for tour in tours], LAPS_MOST_PLACES)
    _, plan = _improve(plan, judge, task.search.tries, np.random.default_rng(0))
    return _laps(plan), _end(plan, judge)


def revise_laps(task: LapTask, past: Past, laps: Laps) -> tuple[Laps, int]:
    """What is left of `laps`, changed for what is known by now, and the step at which they show nothing new."""
    search = task.search
    judge = LapJudge(task, LAPS_LAYOUTS_BY_NOW, past)
    rng = np.random.default_rng(judge.step)
    _, plan = _improve(_plan(laps, LAPS_MOST_PLACES), judge, search.tries_by_now, rng)
    return _laps(plan), _end(plan, judge)


def _plan(laps: Laps | list[np.ndarray], most: int) -> Plan:
    """With room for `most` places a lap, or as many as there are."""
    counts = np.array([len(lap) for lap in laps], dtype=np.int64)
    ways = np.zeros((len(laps), max(most, int(counts.max())), 2))
    for j, lap in enumerate(laps):
        ways[j, : counts[j]] = lap
    return ways, counts


def _laps(plan: Plan) -> Laps:
    return tuple(w[:n].copy() for w, n in zip(*plan, strict=True))


def _end(plan: Plan, judge: LapJudge) -> int:
    share = judge.shares(judge.drive(plan))
    last = int(np.argmax(share >= share[-1]))
    return int(max(judge.task.steps, judge.step + last))


def _first_plans(task: LapTask) -> list[Plan]:
    """Out to a ring along the border and round a share of it or somewhat more, then home.

    All robots alike, from eight sides, both ways.
    """
    lower, upper, starts = np.array(task.lower), np.array(task.upper), np.array(task.starts)
    around = starts[:, :2] - starts[:, :2].mean(axis=0)
    place = np.argsort(np.argsort(np.arctan2(around[:, 1], around[:, 0])))
    plans = []
    arc = 2 * np.pi / len(starts)
    for turn in (arc, -arc, LAPS_OVERLAP * arc, -LAPS_OVERLAP * arc):
        for first in np.arange(8) * np.pi / 4:
            ways, counts = np.zeros((len(starts), LAPS_MOST_PLACES, 2)), np.zeros(len(starts), dtype=np.int64)
            for j, k in enumerate(place):
                lap = [*_on_the_ring(lower, upper, first + arc * k, turn, LAPS_BORDER), starts[j, :2]]
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


def _improve(
    plan: Plan, judge: LapJudge, tries: int, rng: np.random.Generator, heat: float = 1.0
) -> tuple[float, Plan]:
    """The best plan met on a walk of small changes that cools down, and its cost. heat: with which it begins."""
    now = best = judge(plan)
    best_plan = plan
    for k in range(tries if len(judge.movers) else 0):
        left = heat * (1.0 - k / tries)
        size = 1.0 + 8.0 * left
        back = rng.random() < LAPS_REVISITS if len(judge.past.marks) else False
        other = _revisiting(plan, judge, size, rng) if back else _changed(plan, judge, size, rng)
        bound = now - 2.0 * left * np.log(rng.random())
        cost = judge(other, bound)
        if cost < bound:
            plan, now = other, cost
            if now < best:
                best, best_plan = now, plan
    return best, best_plan


def _changed(plan: Plan, judge: LapJudge, size: float, rng: np.random.Generator) -> Plan:
    """One place of one robot moved by about `size` [m], left out or put in, or a stretch of its lap turned round."""
    ways, counts = plan[0].copy(), plan[1].copy()
    lower, upper = judge.lower, judge.upper
    j = int(judge.movers[rng.integers(len(judge.movers))])
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
        _put_in(ways, counts, j, k, np.clip(middle + size * rng.normal(size=2), lower, upper))
    elif n > 1:
        a, b = np.sort(rng.integers(0, n, size=2))
        way[a : b + 1] = way[a : b + 1][::-1].copy()
    return ways, counts


def _revisiting(plan: Plan, judge: LapJudge, size: float, rng: np.random.Generator) -> Plan:
    """One robot sent by a known landmark: instead of one of its places, where the detour is least, or anywhere."""
    ways, counts = plan[0].copy(), plan[1].copy()
    j, marks = int(judge.movers[rng.integers(len(judge.movers))]), judge.past.marks
    way, n, what = ways[j], int(counts[j]), rng.random()
    place = np.clip(marks[rng.integers(len(marks))] + size * rng.normal(size=2), judge.lower, judge.upper)
    if n and (n == len(way) or what < 0.5):
        way[rng.integers(n)] = place
    else:
        k = _least_detour(judge.here[j, :2], way[:n], place) if what < 0.75 else int(rng.integers(n + 1))
        _put_in(ways, counts, j, k, place)
    return ways, counts


def _put_in(ways: np.ndarray, counts: np.ndarray, j: int, k: int, place: np.ndarray) -> None:
    """`place` becomes the k-th of robot j, in place."""
    way, n = ways[j], int(counts[j])
    way[k + 1 : n + 1] = way[k:n].copy()
    way[k] = place
    counts[j] = n + 1


def _least_detour(here: np.ndarray, way: Float[np.ndarray, "n 2"], place: np.ndarray) -> int:
    """Before which place of `way` a detour to `place` is shortest; n where it is best put last."""
    stops = np.vstack([here, way])
    far = np.hypot(*(stops - place).T)
    added: np.ndarray = np.append(far[:-1] + far[1:] - np.hypot(*np.diff(stops, axis=0).T), far[-1])
    return int(np.argmin(added))


def lap_steps(belief: LandmarkBelief, part: JointConfig | CoverageConfig, most_robot_steps: int) -> int:
    """How long the live robots take for laps of an open field at the rate of `part`; 0 where laps are not planned.

    They are not among walls, nor by a team that met under way, nor where the search would take minutes.
    """
    if belief.floor is not None or belief.step > 0:
        return 0
    live = max(1, int(belief.alive.sum()))
    rate = part.rate if live > 1 else part.rate_alone
    steps = round(float(np.prod(belief.upper - belief.lower)) / (rate * live))
    return steps if live * steps <= most_robot_steps else 0


def lap_task(
    belief: LandmarkBelief, poses: np.ndarray, steps: int, part: JointConfig | CoverageConfig, cfg: ExploreConfig
) -> LapTask:
    """Laps from `poses` that should be done after `steps`, searched and judged as `part` says."""
    return LapTask(
        tuple(belief.lower),
        tuple(belief.upper),
        tuple(map(tuple, poses)),
        tuple(map(tuple, cfg.controls)),
        replace(cfg.submap, association="known"),  # which laps are good does not hang on it
        steps,
        cfg.joint.density,
        part.error_weight,
        part.search,
        *((COVERAGE_LOOKS, COVERAGE_SIGHT_MARGIN) if isinstance(part, CoverageConfig) else (1, 0.0)),
    )


def begin(belief: LandmarkBelief, task: LapTask, planned: tuple[Laps, int]) -> None:
    """`planned` are the laps from now on."""
    laps, end = planned
    belief.memory.update(task=task, found=laps, laps=[list(lap) for lap in laps], laps_end=end)


def drive(
    belief: LandmarkBelief,
    poses: Float[np.ndarray, "r 3"],
    cfg: ExploreConfig,
    goal: Callable[[int], np.ndarray | None],
    rest: Callable[[], np.ndarray],
) -> Float[np.ndarray, "r 2"]:
    """Commands of all robots: each live one steers to its goal; one that has none does what `rest` says of all.

    `rest` is asked once at most, and not where every robot has a goal.
    """
    out, others = np.zeros((len(belief.robots), 2)), None
    for j in map(int, np.flatnonzero(belief.alive)):
        to = goal(j)
        if to is not None:
            out[j] = steer(belief, poses[j], to, cfg)
            continue
        others = rest() if others is None else others
        out[j] = others[j]
    return out


def mark_sure(belief: LandmarkBelief, poses: np.ndarray, margin: float, cells: Bool[np.ndarray, "ny nx"]) -> None:
    """Marks in `cells` what the live robots see `margin` [m] within the reach: their poses are estimates."""
    reach, half_angle = belief.memory["task"].submap.reach, belief.memory["task"].submap.half_angle
    for j in np.flatnonzero(belief.alive):
        mark_half_disc(cells, poses[j], Sector(reach - margin, half_angle - margin / reach), belief.explored.raster)


def revise(belief: LandmarkBelief, poses: np.ndarray) -> None:
    """Every so many steps of the laps' time, once enough is known, what is left of them is searched anew.

    To be called every step: where the robots were and what they surely saw is remembered.
    """
    memory, task = belief.memory, belief.memory["task"]
    memory.setdefault("trail", []).append(poses.copy())
    surely = memory.setdefault("surely", np.zeros_like(belief.explored.fused))
    mark_sure(belief, poses, COVERAGE_SURE_MARGIN, surely)
    if not COVERAGE_REVISE_FROM <= belief.step < task.steps or belief.step % COVERAGE_REVISE_EVERY:
        return
    laps = tuple(
        np.array(lap if counts else []).reshape(-1, 2)
        for lap, counts in zip(memory["laps"], belief.alive | belief.away, strict=True)
    )
    past = Past(
        np.stack(memory["trail"], axis=1),
        _known(belief, COVERAGE_SAME_LANDMARK),
        _coarse(surely, belief, task),
        belief.alive.copy(),
    )
    laps, memory["laps_end"] = revise_laps(task, past, laps)
    memory["laps"] = [list(lap) for lap in laps]


def follow(belief: LandmarkBelief, j: int, pose: np.ndarray) -> np.ndarray | None:
    """The next place (2,) of robot j's lap, None when it has passed them all; those passed are gone."""
    lap: list[np.ndarray] = belief.memory["laps"][j]
    while lap and np.hypot(*(lap[0] - pose[:2])) < LAPS_ARRIVED:
        lap.pop(0)
    return lap[0] if lap else None


def _known(belief: LandmarkBelief, same: float) -> Float[np.ndarray, "k 2"]:
    """The landmarks of the map and of all submaps, in the map; those within `same` [m] of another are that one."""
    G = belief.global_map
    marks = list(G.mean)
    for robot, submap, alive in zip(belief.robots, belief.submaps, belief.alive, strict=True):
        for place in se2.act(G.frame_of(robot), submap.mean) if alive else ():
            if all(np.hypot(*(place - other)) > same for other in marks):
                marks.append(place)
    return np.array(marks).reshape(-1, 2)


def _coarse(seen: np.ndarray, belief: LandmarkBelief, task: LapTask) -> Bool[np.ndarray, "ny nx"]:
    """`seen` on the judge's raster: of each of its cells, whether the field's cell at its middle was seen."""
    cell = task.search.coarse_cell
    nx, ny = np.ceil((belief.upper - belief.lower) / cell - 1e-9).astype(int)
    rows, cols = (
        np.minimum(((np.arange(n) + 0.5) * cell / belief.explored.cell).astype(int), most - 1)
        for n, most in zip((ny, nx), seen.shape, strict=True)
    )
    return np.asarray(seen[np.ix_(rows, cols)])
