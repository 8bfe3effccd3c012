"""Laps for a whole team, searched so that the field is seen soon and the map is expected to be sure.

Plans are changed a place at a time and judged by `LapJudge`: before the first step for any layout of landmarks, under
way for the landmarks known by then.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from .lap_judge import LapJudge, LapTask, Past, Plan

Laps = tuple[Float[np.ndarray, "_ 2"], ...]  # the places that each robot should pass in turn


@lru_cache(maxsize=8)
def find_laps(task: LapTask) -> tuple[Laps, int]:
    """The laps for a task that begins, and the step at which they show nothing new any more.

    The same for the same task; the step is no sooner than the task's.
    """
    rng, search = np.random.default_rng(0), task.search
    rough, judge, fine = (LapJudge(task, n) for n in (search.rough_layouts, search.layouts, search.fine_layouts))
    first = sorted(_first_plans(task), key=rough)[: search.first_plans]
    begun = sorted((_improve(plan, rough, search.tries // 4, rng) for plan in first), key=lambda b: b[0])
    better = [_improve(plan, judge, search.tries, rng) for _, plan in begun[: search.finalists]]
    best = min(better, key=lambda b: b[0])[1]
    _, plan = _improve(best, fine, round(search.fine_share * search.tries), rng, search.fine_heat)
    return _laps(plan), _end(plan, fine)


@lru_cache(maxsize=8)
def improve_tours(task: LapTask, tours: tuple[tuple[tuple[float, float], ...], ...]) -> tuple[Laps, int]:
    """Tours of places [m] made laps for a task that begins, and the step at which they show nothing new any more."""
    judge = LapJudge(task, task.search.layouts)
    plan = _plan([np.array(tour).reshape(-1, 2) for tour in tours], task.search.most_places)
    _, plan = _improve(plan, judge, task.search.tries, np.random.default_rng(0))
    return _laps(plan), _end(plan, judge)


def revise_laps(task: LapTask, past: Past, laps: Laps) -> tuple[Laps, int]:
    """What is left of `laps`, changed for what is known by now, and the step at which they show nothing new."""
    search = task.search
    judge = LapJudge(task, search.layouts_by_now, past)
    rng = np.random.default_rng(judge.step)
    _, plan = _improve(_plan(laps, search.most_places), judge, search.tries_by_now, rng)
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
    plans, search = [], task.search
    arc = 2 * np.pi / len(starts)
    for turn in (arc, -arc, search.overlap * arc, -search.overlap * arc):
        for first in np.arange(8) * np.pi / 4:
            ways, counts = np.zeros((len(starts), search.most_places, 2)), np.zeros(len(starts), dtype=np.int64)
            for j, k in enumerate(place):
                lap = [*_on_the_ring(lower, upper, first + arc * k, turn, search.border), starts[j, :2]]
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
        back = rng.random() < judge.task.search.revisits if len(judge.past.marks) else False
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
