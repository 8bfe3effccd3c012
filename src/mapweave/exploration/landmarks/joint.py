"""Laps of all robots planned together before the first step, then repair by coverage, then each other's laps again.

Robots end where one of them began, its own start or another's: ground seen early by anyone closes the loop, so nobody
has to drive all the way home.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from . import coverage, loop
from .belief import Explored, LandmarkBelief
from .config import ExploreConfig
from .lap_following import begin, drive, follow, lap_steps, lap_task, mark_sure
from .lap_search import find_laps


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its lap; when the laps' time is over, what is unseen is covered.

    Asks the run to go on until the laps' time is over: their ends close the loops. Where nothing is left to see, a
    robot follows the next one's lap.
    """
    memory = belief.memory
    if "lap_steps" not in memory:
        memory["lap_steps"] = lap_steps(belief, cfg.joint, cfg.joint.most_robot_steps)
        if memory["lap_steps"]:
            task = lap_task(belief, poses, memory["lap_steps"], cfg.joint, cfg)
            begin(belief, task, find_laps(task))
    if not memory["lap_steps"]:
        return loop.choose(belief, poses, cfg)
    memory["go_on_until"] = memory["lap_steps"]
    _note(belief, poses, cfg)
    seen_by = [bool(belief.explored.known_to(j).all()) for j in range(len(belief.robots))]
    return drive(
        belief,
        poses,
        cfg,
        lambda j: _next(belief, j, poses[j], cfg, seen=seen_by[j]),
        lambda: _repair(belief, poses, cfg),
    )


def _note(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> None:
    """Marks cells as seen with room to spare, a raster for each margin within the sensor's reach, growing.

    Poses are estimates: what was seen at the edge of the reach alone may not have been seen at all.
    """
    joint = cfg.joint
    sure = belief.memory.setdefault("sure", np.zeros((joint.sure_levels, *belief.explored.fused.shape), dtype=bool))
    for k, cells in enumerate(sure):
        mark_sure(belief, poses, (k + 1) * joint.sure_margin, cells)


def _repair(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Coverage of what is unseen; when all was seen and yet something missed, of what was least surely seen first."""
    memory, ex = belief.memory, belief.explored
    if ex.sweeps > memory.get("swept", 1):
        for cells in memory["sure"]:
            again = cells | ex.team()
            if not again.all():
                shadow = Explored(ex.lower, ex.cell, again, np.zeros_like(ex.pending), np.zeros_like(ex.backlog))
                return coverage.cover(replace(belief, explored=shadow), poses, cfg)
        memory["sure"][:] = False
        memory["swept"] = ex.sweeps
    return coverage.cover(belief, poses, cfg)


def _next(belief: LandmarkBelief, j: int, pose: np.ndarray, cfg: ExploreConfig, *, seen: bool) -> np.ndarray | None:
    """Where robot j goes: the next place of its lap while that is worth it, or of another's when all is seen."""
    memory = belief.memory
    goal, lap = follow(belief, j, pose, cfg), memory["laps"][j]
    late = belief.step >= memory["laps_end"]
    if seen and goal is None:
        turns = memory.setdefault("turns", {})
        turns[j] = turns.get(j, 0) + 1
        other = memory["found"][(j + turns[j]) % len(memory["found"])]
        nearest = int(np.argmin(np.hypot(*(other - pose[:2]).T)))
        lap.extend(np.roll(other, -nearest, axis=0))
        return np.asarray(lap[0])
    return goal if seen or not late else None
