"""Laps of all robots planned together before the first step, then repair by coverage, then each other's laps again.

Robots end where one of them began, its own start or another's: ground seen early by anyone closes the loop, so nobody
has to drive all the way home.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...kernels.exploration.objective import mark_half_disc
from . import coverage, loop
from .config import ExploreConfig
from .explored import Explored
from .lap_search import ARRIVED, LapTask, find_laps
from .steering import steer
from .view import TeamView

SURE = 1.0  # [m] within the reach at which a cell is surely seen
LARGEST = 800  # robots times steps; beyond, planning would take minutes, and `loop` takes over


def choose(view: TeamView, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its lap; when the laps' time is over, what is unseen is covered.

    Asks the run to go on until the laps' time is over: their ends close the loops. Where nothing is left to see, a
    robot follows the next one's lap.
    """
    memory = view.memory
    if "lap_steps" not in memory:
        live = max(1, int(view.alive.sum()))
        rate = cfg.joint_rate if live > 1 else cfg.joint_rate_alone
        memory["lap_steps"] = round(float(np.prod(view.upper - view.lower)) / (rate * live))
        memory["joint"] = view.ground is None and live * memory["lap_steps"] <= LARGEST
        if memory["joint"]:
            found, memory["laps_end"] = find_laps(_task(view, poses, memory["lap_steps"], cfg))
            memory["found"] = found
            memory["laps"] = {j: list(lap) for j, lap in enumerate(found)}
    if not memory["joint"]:
        return loop.choose(view, poses, cfg)
    memory["go_on_until"] = memory["lap_steps"]
    _note(view, poses, cfg)
    out = np.zeros((len(view.robots), 2))
    seen_by = [bool(view.explored.known_to(j).all()) for j in range(len(view.robots))]
    rest = None
    for j in map(int, np.flatnonzero(view.alive)):
        goal = _next(view, j, poses[j], seen=seen_by[j])
        if goal is not None:
            out[j] = steer(view, poses[j], goal, cfg)
            continue
        rest = _repair(view, poses, cfg) if rest is None else rest
        out[j] = rest[j]
    return out


def _note(view: TeamView, poses: np.ndarray, cfg: ExploreConfig) -> None:
    """Marks cells as surely seen: a little within the sensor's reach, for poses are estimates."""
    sure = view.memory.setdefault("sure", np.zeros_like(view.explored.fused))
    s, ex = cfg.submap, view.explored
    for j in np.flatnonzero(view.alive):
        mark_half_disc(sure, poses[j], s.reach - SURE, s.half_angle - SURE / s.reach, ex.lower, ex.cell)


def _repair(view: TeamView, poses: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Coverage of what is unseen; when something was missed though all was seen, of what was not surely seen first."""
    sure, ex = view.memory["sure"], view.explored
    if ex.sweeps > view.memory.get("swept", 1):
        if not sure.all():
            shadow = Explored(ex.lower, ex.cell, sure, np.zeros_like(ex.pending), np.zeros_like(ex.backlog))
            return coverage.choose(replace(view, explored=shadow), poses, cfg)
        sure[:] = False
        view.memory["swept"] = ex.sweeps
    return coverage.choose(view, poses, cfg)


def _task(view: TeamView, poses: np.ndarray, steps: int, cfg: ExploreConfig) -> LapTask:
    return LapTask(
        tuple(view.lower),
        tuple(view.upper),
        tuple(map(tuple, poses)),
        tuple(map(tuple, cfg.controls)),
        cfg.submap,
        steps,
        cfg.joint_density,
        cfg.joint_error_weight,
        cfg.joint_tries,
    )


def _next(view: TeamView, j: int, pose: np.ndarray, *, seen: bool) -> np.ndarray | None:
    """Where robot j goes: the next place of its lap while that is worth it, or of another's when all is seen."""
    memory = view.memory
    lap = memory["laps"][j]
    while lap and np.hypot(*(lap[0] - pose[:2])) < ARRIVED:
        lap.pop(0)
    late = view.step >= memory["laps_end"]
    if seen and not lap:
        turns = memory.setdefault("turns", {})
        turns[j] = turns.get(j, 0) + 1
        other = memory["found"][(j + turns[j]) % len(memory["found"])]
        nearest = int(np.argmin(np.hypot(*(other - pose[:2]).T)))
        lap.extend(np.roll(other, -nearest, axis=0))
        return np.asarray(lap[0])
    return np.asarray(lap[0]) if lap and (seen or not late) else None
