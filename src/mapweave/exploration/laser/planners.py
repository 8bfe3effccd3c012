"""The planners for laser worlds by name: each shares out the frontiers in its own way, all drive alike."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .config import LaserExploreConfig
from .frontiers import frontiers, mapped_ground, pockets
from .path_follower import predicted_path, steer
from .planner_state import Goal, LaserBelief, PlannerState, planner_state_of, route_to
from .right_of_way import current_route, priority_order, resolve_conflicts
from .task_allocation import (
    Allocator,
    allocation_problem,
    by_objective,
    by_tours,
    keep_commitments,
    nearest_first,
    parked,
)


def drive(
    belief: LaserBelief,
    poses: Float[np.ndarray, "r 3"],
    cfg: LaserExploreConfig,
    allocate: Allocator,
    *,
    go_home: bool = False,
) -> Float[np.ndarray, "r 2"]:
    """Commands (M, 2) of a team whose frontiers are shared out by `allocate`.

    Sets memory["finished"] when no frontier is left that a robot can get to (and, with `go_home`, all are back);
    memory["goals"]: {robot: place}; memory["given_up"], memory["pockets"]: (n, 2) places [m].
    """
    state = planner_state_of(belief, poses, cfg)
    live = np.flatnonzero(belief.alive)
    _tidy(state, belief, poses, live, cfg)
    if _due(state, belief.step, live, cfg):
        _plan(state, belief, poses, live, cfg, allocate, go_home=go_home)
    resolve_conflicts(state, poses, live, belief.step, cfg)
    belief.memory["goals"] = {j: goal.place for j, goal in state.goals.items()}
    out = np.zeros((len(belief.robots), 2))
    will_be = {int(j): poses[j : j + 1, :2] for j in live}
    for j in priority_order(state, live):
        route = current_route(state, j)
        target = None if route is None else route.target(poses[j, :2], cfg.follower.lookahead)
        if target is not None and np.hypot(*(target - poses[j, :2])) < 0.5 * cfg.resolution:
            target = None
        others = np.concatenate([np.zeros((0, 2)), *(p for k, p in will_be.items() if k != j)])
        out[j] = steer(poses[j], target, belief.scans[j], others, cfg)
        will_be[j] = predicted_path(poses[j], out[j], cfg)
    return out


def _tidy(
    state: PlannerState, belief: LaserBelief, poses: np.ndarray, live: np.ndarray, cfg: LaserExploreConfig
) -> None:
    """Goals that are seen are done; those reached for nothing or out of reach for long are put off."""
    state.yielding = {j: place for j, place in state.yielding.items() if j in live}
    state.goals = {j: goal for j, goal in state.goals.items() if j in live}
    for j, goal in list(state.goals.items()):
        left = float(goal.route.metres_from(poses[j : j + 1, :2])[0])
        if left < goal.least - cfg.goals.progress:
            goal.least, goal.since = left, belief.step
        elif j in state.yielding:
            goal.since += 1
        if left < cfg.goals.arrived and goal.at is None:
            goal.at = belief.step
        if (
            len(goal.unknown)
            and (belief.grid.state[tuple(belief.grid.cells(goal.unknown).T)] >= 0).mean() >= cfg.goals.seen_share
        ):
            goal.done = True
        elif _in_vain(goal, belief.step, cfg):
            state.defer(goal.place, belief.step, cfg)
            del state.goals[j]


def _in_vain(goal: Goal, step: int, cfg: LaserExploreConfig) -> bool:
    """Whether nothing new comes of standing at the goal, or the robot does not get there."""
    if goal.at is not None:
        return len(goal.unknown) > 0 and step - goal.at >= cfg.look
    return step - goal.since > cfg.patience or step - goal.born > cfg.goals.patience_factor * cfg.patience


def _due(state: PlannerState, step: int, live: np.ndarray, cfg: LaserExploreConfig) -> bool:
    age = step - state.planned
    idle = any(j not in state.goals or state.goals[j].done for j in live)
    return state.planned_for != tuple(live) or age >= cfg.replan_every or (idle and age >= cfg.replan_soonest)


def _plan(
    state: PlannerState,
    belief: LaserBelief,
    poses: np.ndarray,
    live: np.ndarray,
    cfg: LaserExploreConfig,
    allocate: Allocator,
    *,
    go_home: bool,
) -> None:
    """New goals for all live robots; who keeps its goal keeps its patience."""
    dead = poses[~belief.alive, :2]
    ground = mapped_ground(belief.grid, poses[live, :2], dead, cfg)
    state.ground, state.planned, state.planned_for = ground, belief.step, tuple(live)
    open_pieces = [f for f in frontiers(ground, cfg) if not state.barred(f.place, belief.step, cfg, waiting=False)]
    pieces = [f for f in open_pieces if not state.barred(f.place, belief.step, cfg)] or open_pieces
    belief.memory["given_up"] = state.given_up(cfg)
    belief.memory["pockets"] = pockets(ground, cfg)
    old = state.goals
    if pieces:
        problem = allocation_problem(ground, pieces, state, poses, live, cfg)
        shared = keep_commitments(problem, allocate(problem, cfg), cfg)
        stand = parked(state, poses, live)
        state.goals = {}
        for j, n in shared.items():
            far = cfg.goals.spare_way + 2.0 * float(problem.first[problem.robots.index(j), n])
            route = route_to(ground, pieces[n].place, stand, cfg, far)
            state.goals[j] = _goal(
                old.get(j), Goal(pieces[n].place, pieces[n].unknown, route, belief.step, belief.step), cfg
            )
    else:
        state.goals = {}
    if not pieces and go_home:
        _send_home(state, old, poses, live, belief.step, cfg)
    belief.memory["finished"] = not pieces and not state.goals


def _goal(old: Goal | None, new: Goal, cfg: LaserExploreConfig) -> Goal:
    """The new goal, with the old one's patience where it is the same place."""
    if old is not None and not old.done and np.hypot(*(old.place - new.place)) < cfg.goals.same:
        return replace(new, since=old.since, born=old.born, least=old.least, at=old.at)
    return new


def _send_home(
    state: PlannerState, old: dict[int, Goal], poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig
) -> None:
    """Everybody who is not back yet heads for its start, unless that was given up."""
    if state.home is None or state.ground is None:
        return
    for j in map(int, live):
        away = np.hypot(*(poses[j, :2] - state.home[j])) > 2 * cfg.goals.arrived
        if away and not state.barred(state.home[j], step, cfg, waiting=False):
            route = route_to(state.ground, state.home[j], np.zeros((0, 2)), cfg)
            state.goals[j] = _goal(old.get(j), Goal(state.home[j], np.zeros((0, 2)), route, step, step), cfg)


def coverage(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Balanced tours over all frontiers by the length of the path; every robot heads for the first of its tour."""
    return drive(belief, poses, cfg, by_tours)


def nearest(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Every robot heads for the nearest frontier that no nearer robot has taken: what the others are measured by."""
    return drive(belief, poses, cfg, nearest_first)


def paper(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Every robot heads for the frontier of largest J: walls to hold on to, new area, distance from the others."""
    return drive(belief, poses, cfg, by_objective(cfg.w_accuracy))


def area(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """`paper` without its accuracy term."""
    return drive(belief, poses, cfg, by_objective(0.0))


def loop(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """`coverage`, then every robot drives back to its start, so that loops close."""
    return drive(belief, poses, cfg, by_tours, go_home=True)
