"""Laps of all robots planned together before the first step, then repair by coverage, then each other's laps again.

Robots end where one of them began, its own start or another's: ground seen early by anyone closes the loop, so nobody
has to drive all the way home.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...kernels.exploration.objective import mark_half_disc
from ...kernels.walls.segments import Sector
from . import coverage, loop
from .belief import Explored, LandmarkBelief
from .config import ExploreConfig
from .lap_search import LapTask, find_laps
from .steering import steer


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its lap; when the laps' time is over, what is unseen is covered.

    Asks the run to go on until the laps' time is over: their ends close the loops. Where nothing is left to see, a
    robot follows the next one's lap.
    """
    memory = belief.memory
    if "lap_steps" not in memory:
        live = max(1, int(belief.alive.sum()))
        rate = cfg.joint.rate if live > 1 else cfg.joint.rate_alone
        memory["lap_steps"] = round(float(np.prod(belief.upper - belief.lower)) / (rate * live))
        memory["joint"] = belief.floor is None and live * memory["lap_steps"] <= cfg.joint.most_robot_steps
        if memory["joint"]:
            found, memory["laps_end"] = find_laps(_task(belief, poses, memory["lap_steps"], cfg))
            memory["found"] = found
            memory["laps"] = {j: list(lap) for j, lap in enumerate(found)}
    if not memory["joint"]:
        return loop.choose(belief, poses, cfg)
    memory["go_on_until"] = memory["lap_steps"]
    _note(belief, poses, cfg)
    out = np.zeros((len(belief.robots), 2))
    seen_by = [bool(belief.explored.known_to(j).all()) for j in range(len(belief.robots))]
    rest = None
    for j in map(int, np.flatnonzero(belief.alive)):
        goal = _next(belief, j, poses[j], cfg, seen=seen_by[j])
        if goal is not None:
            out[j] = steer(belief, poses[j], goal, cfg)
            continue
        rest = _repair(belief, poses, cfg) if rest is None else rest
        out[j] = rest[j]
    return out


def _note(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> None:
    """Marks cells as seen with room to spare, a raster for each margin within the sensor's reach, growing.

    Poses are estimates: what was seen at the edge of the reach alone may not have been seen at all.
    """
    s, ex, joint = cfg.submap, belief.explored, cfg.joint
    sure = belief.memory.setdefault("sure", np.zeros((joint.sure_levels, *ex.fused.shape), dtype=bool))
    for k, cells in enumerate(sure):
        margin = (k + 1) * joint.sure_margin
        sector = Sector(s.reach - margin, s.half_angle - margin / s.reach)
        for j in np.flatnonzero(belief.alive):
            mark_half_disc(cells, poses[j], sector, ex.raster)


def _repair(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Coverage of what is unseen; when all was seen and yet something missed, of what was least surely seen first."""
    memory, ex = belief.memory, belief.explored
    if ex.sweeps > memory.get("swept", 1):
        for cells in memory["sure"]:
            again = cells | ex.team()
            if not again.all():
                shadow = Explored(ex.lower, ex.cell, again, np.zeros_like(ex.pending), np.zeros_like(ex.backlog))
                return coverage.choose(replace(belief, explored=shadow), poses, cfg)
        memory["sure"][:] = False
        memory["swept"] = ex.sweeps
    return coverage.choose(belief, poses, cfg)


def _task(belief: LandmarkBelief, poses: np.ndarray, steps: int, cfg: ExploreConfig) -> LapTask:
    return LapTask(
        tuple(belief.lower),
        tuple(belief.upper),
        tuple(map(tuple, poses)),
        tuple(map(tuple, cfg.controls)),
        cfg.submap,
        steps,
        cfg.joint.density,
        cfg.joint.error_weight,
        cfg.joint.search,
        cfg.steering.heading_cost,
    )


def _next(belief: LandmarkBelief, j: int, pose: np.ndarray, cfg: ExploreConfig, *, seen: bool) -> np.ndarray | None:
    """Where robot j goes: the next place of its lap while that is worth it, or of another's when all is seen."""
    memory = belief.memory
    lap = memory["laps"][j]
    while lap and np.hypot(*(lap[0] - pose[:2])) < cfg.joint.search.arrived:
        lap.pop(0)
    late = belief.step >= memory["laps_end"]
    if seen and not lap:
        turns = memory.setdefault("turns", {})
        turns[j] = turns.get(j, 0) + 1
        other = memory["found"][(j + turns[j]) % len(memory["found"])]
        nearest = int(np.argmin(np.hypot(*(other - pose[:2]).T)))
        lap.extend(np.roll(other, -nearest, axis=0))
        return np.asarray(lap[0])
    return np.asarray(lap[0]) if lap and (seen or not late) else None
