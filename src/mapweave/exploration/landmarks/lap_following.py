"""Laps followed and changed under way: every few steps what is left of them is searched anew for what is known by now.

What was seen, where the landmarks lie and where the robots have been replaces what had to be assumed before: a lap that
would close on ground without landmarks is led by ones that the map holds.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ...core import se2
from ...kernels.exploration.objective import mark_half_disc
from ...kernels.walls.segments import Sector
from .belief import LandmarkBelief
from .config import CoverageConfig, ExploreConfig, JointConfig
from .lap_judge import LapTask, Past
from .lap_search import Laps, revise_laps
from .steering import steer


def lap_steps(belief: LandmarkBelief, part: JointConfig | CoverageConfig, most_robot_steps: int) -> int:
    """How long the live robots take for laps of an open field at the rate of `part`; 0 where laps are not planned.

    They are not among walls, nor where the search would take minutes.
    """
    if belief.floor is not None:
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
        cfg.steering.heading_cost,
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


def revise(belief: LandmarkBelief, poses: np.ndarray, cfg: CoverageConfig) -> None:
    """Every `revise_every` steps of the laps' time, once enough is known, what is left of them is searched anew.

    To be called every step: where the robots were and what they surely saw is remembered.
    """
    memory, task = belief.memory, belief.memory["task"]
    memory.setdefault("trail", []).append(poses.copy())
    surely = memory.setdefault("surely", np.zeros_like(belief.explored.fused))
    mark_sure(belief, poses, cfg.sure_margin, surely)
    if not cfg.revise_from <= belief.step < task.steps or belief.step % cfg.revise_every:
        return
    laps = tuple(
        np.array(lap if alive else []).reshape(-1, 2) for lap, alive in zip(memory["laps"], belief.alive, strict=True)
    )
    past = Past(
        np.stack(memory["trail"], axis=1),
        _known(belief, cfg.same_landmark),
        _coarse(surely, belief, task),
        belief.alive.copy(),
    )
    laps, memory["laps_end"] = revise_laps(task, past, laps)
    memory["laps"] = [list(lap) for lap in laps]


def follow(belief: LandmarkBelief, j: int, pose: np.ndarray, cfg: ExploreConfig) -> np.ndarray | None:
    """The next place (2,) of robot j's lap, None when it has passed them all; those passed are gone."""
    lap: list[np.ndarray] = belief.memory["laps"][j]
    while lap and np.hypot(*(lap[0] - pose[:2])) < cfg.joint.search.arrived:
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
