"""Two robots in one door: who goes first, and where the other waits."""

import numpy as np

from ..ground import Ground
from .config import LaserExploreConfig
from .frontiers import disc_mask
from .planner_state import ClearCostToGo, PlannerState, YieldPlace, route_to


def priority_order(state: PlannerState, live: np.ndarray) -> list[int]:
    """Live robots by who goes first: by rank, those with nothing to do last."""
    return sorted(map(int, live), key=lambda j: (j not in state.goals and j not in state.yielding, state.priority[j]))


def current_route(state: PlannerState, j: int) -> ClearCostToGo | None:
    """The route robot j follows now: to where it lets another pass, else to its goal."""
    if j in state.yielding:
        return state.yielding[j].route
    return state.goals[j].route if j in state.goals else None


def resolve_conflicts(
    state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig
) -> None:
    """Whoever stands in the way of a robot that goes first gets a place aside; who has waited long enough goes on."""
    _end_waiting(state, poses, live, step, cfg)
    _get_unstuck(state, poses, live, step, cfg)
    ranked, rules = priority_order(state, live), cfg.right_of_way
    near = 2 * cfg.radius + cfg.apart
    for a, i in enumerate(ranked):
        for k in ranked[a + 1 :]:
            if k in state.yielding or np.hypot(*(poses[i, :2] - poses[k, :2])) > rules.meeting:
                continue
            if not _in_way(state, poses, i, k, near, rules.next_way):
                continue
            leaving = (
                k in state.goals
                and state.still[k] < rules.leaving_steps
                and not _in_way(state, poses, k, i, near, rules.next_way)
            )
            if not leaving and not _yield_to(state, poses, k, i, step, cfg) and i not in state.yielding:
                state.priority[i], state.priority[k] = state.priority[k], state.priority[i]
                _yield_to(state, poses, i, k, step, cfg)


def _in_way(state: PlannerState, poses: np.ndarray, i: int, k: int, near: float, ahead: float) -> bool:
    """Whether robot k stands on the next part of robot i's path."""
    route = current_route(state, i)
    way = route.along(poses[i, :2], ahead) if route is not None else np.zeros((0, 2))
    return len(way) > 0 and float(np.hypot(*(way - poses[k, :2]).T).min()) < near


def _yield_to(state: PlannerState, poses: np.ndarray, k: int, i: int, step: int, cfg: LaserExploreConfig) -> bool:
    """Robot k goes to the nearest place beside robot i's path; whether there is one."""
    ground, route = state.ground, current_route(state, i)
    if ground is None or route is None:
        return False
    way = np.vstack([poses[i : i + 1, :2], route.along(poses[i, :2], cfg.right_of_way.clear_way)])
    near = 2 * cfg.radius + cfg.apart
    others = np.array([p[:2] for j, p in enumerate(poses) if j not in (i, k)]).reshape(-1, 2)
    weight = ground.weight.copy()
    weight[disc_mask(ground.grid, poses[i : i + 1, :2], near)] = 0
    if len(others):
        weight[disc_mask(ground.grid, others, near)] = 0
    left = Ground(weight, ground.lower, ground.cell, ground.snap)
    cost = left.cost_to_go(left.cells(poses[k : k + 1, :2])).cost
    cost[disc_mask(ground.grid, way, near + cfg.right_of_way.beside)] = -1
    cells = np.argwhere(cost >= 0)
    if len(cells) == 0:
        return False
    best = cells[np.argmin(cost[tuple(cells.T)])]
    place = ground.grid.centres(best[None])[0]
    state.yielding[k] = YieldPlace(
        place, route_to(ground, place, poses[i : i + 1, :2], cfg), i, step + cfg.right_of_way.wait_steps
    )
    return True


def _end_waiting(state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
    near, rules = 2 * cfg.radius + cfg.apart, cfg.right_of_way
    for k, waiting in list(state.yielding.items()):
        i = waiting.whom
        if i == k:
            if step >= waiting.until or np.hypot(*(waiting.place - poses[k, :2])) < rules.retry_arrived:
                del state.yielding[k]
            continue
        gone = i not in live or np.hypot(*(poses[i, :2] - poses[k, :2])) > rules.parted * rules.meeting
        passed = not _in_way(state, poses, i, k, near, rules.clear_way) and not _goal_blocked(
            state, poses, k, i, near, cfg
        )
        if gone or passed or step >= waiting.until:
            del state.yielding[k]
            if not gone and not passed and state.priority[k] > state.priority[i]:
                state.priority[i], state.priority[k] = state.priority[k], state.priority[i]


def _goal_blocked(state: PlannerState, poses: np.ndarray, k: int, i: int, near: float, cfg: LaserExploreConfig) -> bool:
    """Whether robot i stands on the next part of robot k's path to its goal."""
    if k not in state.goals:
        return False
    way = state.goals[k].route.along(poses[k, :2], cfg.right_of_way.next_way)
    return len(way) > 0 and float(np.hypot(*(way - poses[i, :2]).T).min()) < near


def _get_unstuck(state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
    """Who has a goal and yet stays about one place for long goes some other way first; ranks are drawn anew.

    The lots are the same in the same run.
    """
    ground, rules = state.ground, cfg.right_of_way
    for j in map(int, live):
        if (
            ground is None
            or j not in state.goals
            or j in state.yielding
            or step - state.about[j, 2] < rules.stuck_steps
        ):
            continue
        rng = np.random.default_rng([step, j])
        state.about[j, 2] = step
        state.priority = rng.permutation(len(state.priority)).astype(float)
        metres = ground.cost_to_go(ground.cells(poses[j : j + 1, :2])).metres
        around = (metres > rules.retry_from) & (metres < rules.retry_to)
        cells = np.argwhere(around & (ground.weight == ground.weight[around].min(initial=255)))
        if len(cells):
            place = ground.grid.centres(rng.choice(cells)[None])[0]
            state.yielding[j] = YieldPlace(
                place, route_to(ground, place, np.zeros((0, 2)), cfg), j, step + rules.retry_steps
            )
