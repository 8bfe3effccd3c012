"""A coverage loop for each robot that closes on its start, then repair by coverage.

Closing a loop brings early, well-known landmarks back into view at the end of the drive, which pulls the whole lap in.
"""

import numpy as np
from jaxtyping import Float

from ...kernels.exploration.tours import balanced_tours
from . import among_walls, coverage
from .config import ExploreConfig
from .view import TeamView

ARRIVED = 4.0  # [m]


def choose(view: TeamView, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its closed tour, skipping discs that are seen, then helps to cover what is left.

    Asks the run to go on to `loop_steps` after all landmarks were seen, unless every loop has closed before.
    """
    memory = view.memory
    if "laps" not in memory:
        memory["home"] = poses[:, :2].copy()
        memory["laps"] = plan_laps(view, poses, cfg)
    memory["go_on_until"] = 0 if _closed(view, memory) else loop_steps(view, cfg)
    out = np.zeros((len(view.robots), 2))
    idle = []
    for j in map(int, np.flatnonzero(view.alive)):
        lap = memory["laps"][j]
        while lap and _passed(view, j, poses[j], lap, cfg):
            lap.pop(0)
        if lap:
            out[j] = coverage.towards(view, j, poses[j], lap[0], cfg)
        else:
            idle.append(j)
    if idle:
        rest = coverage.choose(view, poses, cfg)
        for j in idle:
            out[j] = rest[j]
    return out


def loop_steps(view: TeamView, cfg: ExploreConfig) -> int:
    """How long the live robots need, at the configured rate, to lap the whole field."""
    width, height = view.upper - view.lower
    area = float(width * height) if view.ground is None else view.ground.area
    live = max(1, int(view.alive.sum()))
    rate = cfg.loop_rate if live > 1 else cfg.loop_rate_alone
    return round(area / (rate * live))


def plan_laps(view: TeamView, poses: np.ndarray, cfg: ExploreConfig) -> dict[int, list[np.ndarray]]:
    """For each live robot the discs of its closed tour in order, its home last."""
    live = np.flatnonzero(view.alive)
    ex = view.explored
    cells = ex.centres(np.argwhere(~ex.team()))
    if len(cells) == 0:
        return {int(j): [] for j in live}
    if view.ground is not None:
        return among_walls.laps(view, view.ground, cells, poses, live, cfg)
    chosen = coverage.discs(view, cells, cfg.loop_radius)
    first = coverage.approach_cost(poses[live], chosen)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    last = np.linalg.norm(chosen[None] - poses[live][:, None, :2], axis=-1)
    tours, counts = balanced_tours(first, between, last)
    return {int(j): [*(chosen[i] for i in tours[k, : counts[k]]), poses[j, :2].copy()] for k, j in enumerate(live)}


def _passed(view: TeamView, j: int, pose: np.ndarray, lap: list[np.ndarray], cfg: ExploreConfig) -> bool:
    """Whether the lap's next place was reached, or all its disc covers is seen; home itself must be reached."""
    if np.hypot(*(lap[0] - pose[:2])) < ARRIVED:
        return view.ground is None or bool(view.ground.sees(pose[:2], lap[0][None], ARRIVED)[0])
    if len(lap) == 1:
        return False
    ex = view.explored
    cells = ex.centres(np.argwhere(~ex.known_to(j)))
    if view.ground is not None:
        return not view.ground.sees(lap[0], cells, cfg.loop_radius).any()
    return len(cells) == 0 or bool(np.hypot(*(cells - lap[0]).T).min() > cfg.loop_radius)


def _closed(view: TeamView, memory: dict[str, list]) -> bool:
    return all(not memory["laps"][int(j)] for j in np.flatnonzero(view.alive))
