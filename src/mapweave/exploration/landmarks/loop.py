"""A coverage loop for each robot that closes on its start, then repair by coverage.

Closing a loop brings early, well-known landmarks back into view at the end of the drive, which pulls the whole lap in.
"""

import numpy as np
from jaxtyping import Float

from ...kernels.exploration.tours import balanced_tours
from . import among_walls, coverage
from .belief import LandmarkBelief
from .config import ExploreConfig


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its closed tour, skipping discs that are seen, then helps to cover what is left.

    Asks the run to go on to `loop_steps` after all landmarks were seen, unless every loop has closed before.
    """
    memory = belief.memory
    if "laps" not in memory:
        memory["home"] = poses[:, :2].copy()
        memory["laps"] = plan_laps(belief, poses, cfg)
    memory["go_on_until"] = 0 if _closed(belief, memory["laps"]) else loop_steps(belief, cfg)
    out = np.zeros((len(belief.robots), 2))
    idle = []
    for j in map(int, np.flatnonzero(belief.alive)):
        lap = memory["laps"][j]
        while lap and _passed(belief, j, poses[j], lap, cfg):
            lap.pop(0)
        if lap:
            out[j] = coverage.towards(belief, j, poses[j], lap[0], cfg)
        else:
            idle.append(j)
    if idle:
        rest = coverage.cover(belief, poses, cfg)
        for j in idle:
            out[j] = rest[j]
    return out


def loop_steps(belief: LandmarkBelief, cfg: ExploreConfig) -> int:
    """How long the live robots need, at the configured rate, to lap the whole field."""
    width, height = belief.upper - belief.lower
    area = float(width * height) if belief.floor is None else belief.floor.area
    live = max(1, int(belief.alive.sum()))
    rate = cfg.loop.rate if live > 1 else cfg.loop.rate_alone
    return round(area / (rate * live))


def plan_laps(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> dict[int, list[np.ndarray]]:
    """For each live robot the discs of its closed tour in order, its home last."""
    live = np.flatnonzero(belief.alive)
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.team()))
    if len(cells) == 0:
        return {int(j): [] for j in live}
    if belief.floor is not None:
        return among_walls.laps(belief, belief.floor, cells, poses, live, cfg)
    chosen = coverage.discs(belief, cells, cfg.loop.radius)
    first = coverage.approach_cost(poses[live], chosen, cfg.coverage.turn_cost)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    last = np.ascontiguousarray(np.linalg.norm(chosen[None] - poses[live][:, None, :2], axis=-1))
    tours, counts = balanced_tours(first, between, last, cfg.coverage.balance)
    return {int(j): [*(chosen[i] for i in tours[k, : counts[k]]), poses[j, :2].copy()] for k, j in enumerate(live)}


def _passed(belief: LandmarkBelief, j: int, pose: np.ndarray, lap: list[np.ndarray], cfg: ExploreConfig) -> bool:
    """Whether the lap's next place was reached, or all its disc covers is seen; home itself must be reached."""
    if np.hypot(*(lap[0] - pose[:2])) < cfg.loop.arrived:
        return belief.floor is None or bool(belief.floor.sees(pose[:2], lap[0][None], cfg.loop.arrived)[0])
    if len(lap) == 1:
        return False
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.known_to(j)))
    if belief.floor is not None:
        return not belief.floor.sees(lap[0], cells, cfg.loop.radius).any()
    return len(cells) == 0 or bool(np.hypot(*(cells - lap[0]).T).min() > cfg.loop.radius)


def _closed(belief: LandmarkBelief, laps: dict[int, list[np.ndarray]]) -> bool:
    return all(not laps[int(j)] for j in np.flatnonzero(belief.alive))
