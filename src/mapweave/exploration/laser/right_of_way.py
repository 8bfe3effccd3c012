"""Two robots in one door: who goes first, and where the other waits."""

import numpy as np

from ...kernels.exploration.wavefront import NO_LIMIT, STRAIGHT, spread
from .frontiers import disc_mask, nearest_cells
from .planner_state import Aside, Crew, Ways, ways_to
from .view import LaserExploreConfig

MEET = 2.5  # [m], robots farther apart than this do not meet
NEXT = 2.0  # [m] of way that may be in another's way
WHOLE = 6.0  # [m] of way that a waiting robot keeps clear of
WAIT = 40  # steps a robot waits aside at most
BESIDE = 0.1  # [m] beyond what two robots need, where a robot waits
STUCK = 30  # steps about one place after which a robot tries something else
NEARBY = (1.0, 4.0)  # [m], how far away from there
RETRY = 15  # steps it takes for that at most


def order(crew: Crew, live: np.ndarray) -> list[int]:
    """Live robots by who goes first: by rank, those with nothing to do last."""
    return sorted(map(int, live), key=lambda j: (j not in crew.goals and j not in crew.asides, crew.rank[j]))


def heading(crew: Crew, j: int) -> Ways | None:
    """The ways robot j follows now: aside, else to its goal."""
    if j in crew.asides:
        return crew.asides[j].ways
    return crew.goals[j].ways if j in crew.goals else None


def give_way(crew: Crew, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
    """Whoever stands in the way of a robot that goes first gets a place aside; who has waited long enough goes on."""
    _end_waiting(crew, poses, live, step, cfg)
    _get_unstuck(crew, poses, live, step, cfg)
    ranked = order(crew, live)
    near = 2 * cfg.radius + cfg.apart
    for a, i in enumerate(ranked):
        for k in ranked[a + 1 :]:
            if k in crew.asides or np.hypot(*(poses[i, :2] - poses[k, :2])) > MEET:
                continue
            if not _in_way(crew, poses, i, k, near):
                continue
            leaving = k in crew.goals and crew.still[k] < 3 and not _in_way(crew, poses, k, i, near)
            if not leaving and not _step_aside(crew, poses, k, i, step, cfg) and i not in crew.asides:
                crew.rank[i], crew.rank[k] = crew.rank[k], crew.rank[i]
                _step_aside(crew, poses, i, k, step, cfg)


def _in_way(crew: Crew, poses: np.ndarray, i: int, k: int, near: float, ahead: float = NEXT) -> bool:
    """Whether robot k stands on the next part of robot i's way."""
    ways = heading(crew, i)
    way = ways.down(poses[i, :2], ahead) if ways is not None else np.zeros((0, 2))
    return len(way) > 0 and float(np.hypot(*(way - poses[k, :2]).T).min()) < near


def _step_aside(crew: Crew, poses: np.ndarray, k: int, i: int, step: int, cfg: LaserExploreConfig) -> bool:
    """Robot k goes to the nearest place beside robot i's way; whether there is one."""
    ground, ways = crew.ground, heading(crew, i)
    if ground is None or ways is None:
        return False
    way = np.vstack([poses[i : i + 1, :2], ways.down(poses[i, :2], WHOLE)])
    near = 2 * cfg.radius + cfg.apart
    others = np.array([p[:2] for j, p in enumerate(poses) if j not in (i, k)]).reshape(-1, 2)
    weight = ground.weight.copy()
    weight[disc_mask(ground.grid, poses[i : i + 1, :2], near)] = 0
    if len(others):
        weight[disc_mask(ground.grid, others, near)] = 0
    cost = spread(weight, nearest_cells(ground.grid, weight > 0, poses[k : k + 1, :2]), NO_LIMIT)
    cost[disc_mask(ground.grid, way, near + BESIDE)] = -1
    cells = np.argwhere(cost >= 0)
    if len(cells) == 0:
        return False
    best = cells[np.argmin(cost[tuple(cells.T)])]
    place = ground.grid.centres(best[None])[0]
    crew.asides[k] = Aside(place, ways_to(ground, place, poses[i : i + 1, :2], cfg), i, step + WAIT)
    return True


def _end_waiting(crew: Crew, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
    near = 2 * cfg.radius + cfg.apart
    for k, aside in list(crew.asides.items()):
        i = aside.whom
        if i == k:
            if step >= aside.until or np.hypot(*(aside.place - poses[k, :2])) < 0.3:
                del crew.asides[k]
            continue
        gone = i not in live or np.hypot(*(poses[i, :2] - poses[k, :2])) > 1.5 * MEET
        passed = not _in_way(crew, poses, i, k, near, WHOLE) and not _goal_blocked(crew, poses, k, i, near)
        if gone or passed or step >= aside.until:
            del crew.asides[k]
            if not gone and not passed and crew.rank[k] > crew.rank[i]:
                crew.rank[i], crew.rank[k] = crew.rank[k], crew.rank[i]


def _goal_blocked(crew: Crew, poses: np.ndarray, k: int, i: int, near: float) -> bool:
    """Whether robot i stands on the next part of robot k's way to its goal."""
    if k not in crew.goals:
        return False
    way = crew.goals[k].ways.down(poses[k, :2], NEXT)
    return len(way) > 0 and float(np.hypot(*(way - poses[i, :2]).T).min()) < near


def _get_unstuck(crew: Crew, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
    """Who has a goal and yet stays about one place for long goes some other way first; ranks are drawn anew.

    The lots are the same in the same run.
    """
    ground = crew.ground
    for j in map(int, live):
        if ground is None or j not in crew.goals or j in crew.asides or step - crew.about[j, 2] < STUCK:
            continue
        rng = np.random.default_rng([step, j])
        crew.about[j, 2] = step
        crew.rank = rng.permutation(len(crew.rank)).astype(float)
        here = spread(ground.weight, nearest_cells(ground.grid, ground.weight > 0, poses[j : j + 1, :2]), NO_LIMIT)
        metres = here * ground.grid.resolution / STRAIGHT
        around = (metres > NEARBY[0]) & (metres < NEARBY[1])
        cells = np.argwhere(around & (ground.weight == ground.weight[around].min(initial=255)))
        if len(cells):
            place = ground.grid.centres(rng.choice(cells)[None])[0]
            crew.asides[j] = Aside(place, ways_to(ground, place, np.zeros((0, 2)), cfg), j, step + RETRY)
