"""Discs over everything unexplored, shared out as balanced tours and planned anew every few steps.

In an open field the first tours are improved as laps are: a robot that comes by known ground at the right time closes
a loop, which shortest tours do only by chance.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ...core.se2 import wrap_angle
from ...kernels.exploration.tours import balanced_tours, greedy_cover
from . import among_walls
from .belief import LandmarkBelief
from .config import ExploreConfig
from .lap_following import begin, drive, follow, lap_steps, lap_task, revise
from .lap_search import improve_tours
from .steering import ahead, given_up, nearest_unexplored, new_cells, next_target, offered, steer


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its tour in an open field; elsewhere, and afterwards, what is left is covered.

    Asks the run to go on until the tours' time is over: their ends close loops.
    """
    memory = belief.memory
    if "tour_steps" not in memory:
        memory["tour_steps"] = lap_steps(belief, cfg.coverage, cfg.joint.most_robot_steps)
        if memory["tour_steps"]:
            begin_tours(belief, poses, cfg)
    if not memory["tour_steps"]:
        return cover(belief, poses, cfg)
    memory["go_on_until"] = memory["tour_steps"]
    revise(belief, poses, cfg.coverage)

    def goal(j: int) -> np.ndarray | None:
        return follow(belief, j, poses[j], cfg) if belief.step < memory["laps_end"] else None

    return drive(belief, poses, cfg, goal, lambda: cover(belief, poses, cfg))


def begin_tours(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> None:
    """Balanced tours over discs on the whole field, improved, are the laps from now on."""
    live = np.flatnonzero(belief.alive)
    every = np.argwhere(np.ones_like(belief.explored.fused))
    chosen = discs(belief, belief.explored.centres(every), cfg.coverage.tour_radius)
    tours, counts = balanced_tours(
        approach_cost(poses[live], chosen, cfg.coverage.turn_cost),
        np.linalg.norm(chosen[:, None] - chosen[None], axis=-1),
        np.zeros((len(live), len(chosen))),
        cfg.coverage.balance,
    )
    places: list[tuple[tuple[float, float], ...]] = [()] * len(belief.robots)
    for k, j in enumerate(live):
        places[j] = tuple((float(x), float(y)) for x, y in chosen[tours[k, : counts[k]]])
    task = lap_task(belief, poses, belief.memory["tour_steps"], cfg.coverage, cfg)
    begin(belief, task, improve_tours(task, tuple(places)))


def cover(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Every live robot heads for the first disc of its tour, on a course that shows it new ground on the way."""
    memory = belief.memory
    live = np.flatnonzero(belief.alive)
    stale = belief.step >= memory.get("plan_until", -1) or memory.get("plan_for") != tuple(live)
    if stale:
        memory["goals"] = plan(belief, poses, live, cfg)
        memory["plan_until"] = belief.step + cfg.coverage.replan_every
        memory["plan_for"] = tuple(live)
    out = np.zeros((len(belief.robots), 2))
    for j in live:
        goal = held_target(belief, int(j), poses[j], cfg)
        if goal is not None:
            out[j] = steer(belief, poses[j], goal, cfg)
        else:
            out[j] = towards(belief, int(j), poses[j], memory["goals"].get(int(j)), cfg)
    return out


def held_target(belief: LandmarkBelief, j: int, pose: np.ndarray, cfg: ExploreConfig) -> np.ndarray | None:
    """After `stall_steps` without new ground: the nearest unexplored cell, held until it is seen; else None.

    It breaks the ties in which plans made anew send a robot to and fro.
    """
    targets: dict[int, np.ndarray] = belief.memory.setdefault("targets", {})
    ex = belief.explored
    if j in targets and (ex.sees(j, targets[j]) or given_up(belief, j, targets[j], cfg)):
        del targets[j]
    if j not in targets and belief.stalled[j] >= cfg.objective.stall_steps:
        goal = next_target(belief, j, pose)
        if goal is not None:
            targets[j] = goal
    return targets.get(j)


def plan(belief: LandmarkBelief, poses: np.ndarray, live: np.ndarray, cfg: ExploreConfig) -> dict[int, np.ndarray]:
    """The next place (2,) for each live robot: the first disc of its tour, or the nearest unexplored cell."""
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.team()))
    if len(cells) == 0:
        return {}
    if belief.floor is not None:
        return among_walls.plan(belief, belief.floor, cells, poses, live, cfg)
    chosen = discs(belief, cells, cfg.coverage.radius)
    first = approach_cost(poses[live], chosen, cfg.coverage.turn_cost)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), cfg.coverage.balance)
    goals: dict[int, np.ndarray] = {}
    for k, j in enumerate(live):
        goal = chosen[tours[k, 0]] if counts[k] else nearest_unexplored(cells, poses[j])
        if goal is not None:
            goals[int(j)] = goal
    return goals


def approach_cost(
    poses: Float[np.ndarray, "r 3"], places: Float[np.ndarray, "n 2"], turn_cost: float
) -> Float[np.ndarray, "r n"]:
    """Distance [m] from each pose to each place, with what turning towards it costs at `turn_cost` [m/rad]."""
    d = places[None, :, :] - poses[:, None, :2]
    angle = np.abs(wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - poses[:, None, 2]))
    return np.asarray(np.hypot(d[..., 0], d[..., 1]) + turn_cost * angle)


def towards(
    belief: LandmarkBelief, j: int, pose: np.ndarray, goal: np.ndarray | None, cfg: ExploreConfig
) -> np.ndarray:
    """The offered control (2,) that trades getting to `goal` against new cells seen; straight on without a goal."""
    place = None if goal is None else ahead(belief, pose, goal, cfg)
    controls, after = offered(belief, pose, cfg, place)
    if place is None:
        return np.asarray(controls[np.argmax(controls[:, 0] - np.abs(controls[:, 1]))])
    d = place - after[:, :2]
    error = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - after[:, 2]))
    distance = np.hypot(d[:, 0], d[:, 1])
    gain = new_cells(belief, j, after, cfg)
    return np.asarray(
        controls[np.argmin(distance + cfg.steering.heading_cost * error - cfg.coverage.gain_weight * gain)]
    )


def discs(belief: LandmarkBelief, cells: Float[np.ndarray, "n 2"], radius: float) -> Float[np.ndarray, "k 2"]:
    """Few places (k, 2) [m] within `radius` of which all `cells` lie: each the middle of the cells it covers."""
    return discs_over(belief.lower, belief.upper, cells, radius)


def discs_over(
    lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"], cells: Float[np.ndarray, "n 2"], radius: float
) -> Float[np.ndarray, "k 2"]:
    """The same for `cells` of any rectangle."""
    step = radius / 3
    xs, ys = (
        np.linspace(lo + step, hi - step, max(2, round((hi - lo - 2 * step) / step) + 1))
        for lo, hi in zip(lower, upper, strict=True)
    )
    return to_the_middle(greedy_cover(np.ascontiguousarray(cells), xs, ys, radius), cells, radius)


def to_the_middle(places: np.ndarray, cells: np.ndarray, radius: float) -> np.ndarray:
    """Each place moved to the mean of the cells within `radius` of it."""
    near = cKDTree(cells).query_ball_point(places, radius)
    return np.array([cells[some].mean(axis=0) if some else p for some, p in zip(near, places, strict=True)]).reshape(
        -1, 2
    )
