"""One step of a laser team: look what became of the goals, plan anew when it is time, give way, drive."""

import numpy as np
from jaxtyping import Float

from .frontiers import frontiers, pockets, survey
from .path_follower import AHEAD, driven, steer
from .planner_state import SAME, Crew, Goal, Ways, crew_of, ways_to
from .right_of_way import give_way, heading, order
from .task_allocation import Share, hold, offer, parked
from .view import LaserExploreConfig, LaserView

ARRIVED = 0.35  # [m]
NEARER = 0.2  # [m], what counts as progress
SEEN = 0.8  # share of a goal's unknown cells after which it is done
SPARE = 20.0  # [m], how much farther than needed ways to a goal are looked for
LONG = 10  # times `patience` after which a goal is put off however often it came nearer


def drive(
    view: LaserView, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig, share: Share, *, go_home: bool = False
) -> Float[np.ndarray, "r 2"]:
    """Commands (M, 2) of a team whose frontiers are shared out by `share`.

    Sets memory["finished"] when no frontier is left that a robot can get to (and, with `go_home`, all are back);
    memory["goals"]: {robot: place}; memory["given_up"], memory["pockets"]: (n, 2) places [m].
    """
    crew = crew_of(view, poses)
    live = np.flatnonzero(view.alive)
    _tidy(crew, view, poses, live, cfg)
    if _due(crew, view.step, live, cfg):
        _plan(crew, view, poses, live, cfg, share, go_home=go_home)
    give_way(crew, poses, live, view.step, cfg)
    view.memory["goals"] = {j: goal.place for j, goal in crew.goals.items()}
    out = np.zeros((len(view.robots), 2))
    will_be = {int(j): poses[j : j + 1, :2] for j in live}
    for j in order(crew, live):
        ways = heading(crew, j)
        target = None if ways is None else ways.target(poses[j, :2], AHEAD)
        if target is not None and np.hypot(*(target - poses[j, :2])) < 0.5 * cfg.resolution:
            target = None
        others = np.concatenate([np.zeros((0, 2)), *(p for k, p in will_be.items() if k != j)])
        out[j] = steer(poses[j], target, view.scans[j], others, cfg)
        will_be[j] = driven(poses[j], out[j], cfg)
    return out


def _tidy(crew: Crew, view: LaserView, poses: np.ndarray, live: np.ndarray, cfg: LaserExploreConfig) -> None:
    """Goals that are seen are done; those reached for nothing or out of reach for long are put off."""
    crew.asides = {j: aside for j, aside in crew.asides.items() if j in live}
    crew.goals = {j: goal for j, goal in crew.goals.items() if j in live}
    for j, goal in list(crew.goals.items()):
        left = float(goal.ways.metres(poses[j : j + 1, :2])[0])
        if left < goal.least - NEARER:
            goal.least, goal.since = left, view.step
        elif j in crew.asides:
            goal.since += 1
        if left < ARRIVED and goal.at is None:
            goal.at = view.step
        if len(goal.unknown) and (view.grid.state[tuple(view.grid.cells(goal.unknown).T)] >= 0).mean() >= SEEN:
            goal.done = True
        elif _in_vain(goal, view.step, cfg):
            crew.defer(goal.place, view.step, cfg)
            del crew.goals[j]


def _in_vain(goal: Goal, step: int, cfg: LaserExploreConfig) -> bool:
    """Whether nothing new comes of standing at the goal, or the robot does not get there."""
    if goal.at is not None:
        return len(goal.unknown) > 0 and step - goal.at >= cfg.look
    return step - goal.since > cfg.patience or step - goal.born > LONG * cfg.patience


def _due(crew: Crew, step: int, live: np.ndarray, cfg: LaserExploreConfig) -> bool:
    age = step - crew.planned
    idle = any(j not in crew.goals or crew.goals[j].done for j in live)
    return crew.planned_for != tuple(live) or age >= cfg.replan_every or (idle and age >= cfg.replan_soonest)


def _plan(
    crew: Crew,
    view: LaserView,
    poses: np.ndarray,
    live: np.ndarray,
    cfg: LaserExploreConfig,
    share: Share,
    *,
    go_home: bool,
) -> None:
    """New goals for all live robots; who keeps its goal keeps its patience."""
    dead = poses[~view.alive, :2]
    ground = survey(view.grid, poses[live, :2], dead, cfg)
    crew.ground, crew.planned, crew.planned_for = ground, view.step, tuple(live)
    found = [f for f in frontiers(ground, cfg) if not crew.barred(f.place, view.step, cfg, waiting=False)]
    pieces = [f for f in found if not crew.barred(f.place, view.step, cfg)] or found
    view.memory["given_up"] = crew.given_up(cfg)
    view.memory["pockets"] = pockets(ground, cfg)
    old = crew.goals
    if pieces:
        offers = offer(ground, pieces, crew, poses, live, cfg)
        shared = hold(offers, share(offers, cfg), cfg)
        stand = parked(crew, poses, live)
        crew.goals = {}
        for j, n in shared.items():
            far = SPARE + 2.0 * float(offers.first[offers.robots.index(j), n])
            ways = ways_to(ground, pieces[n].place, stand, cfg, far)
            crew.goals[j] = _goal(old.get(j), pieces[n].place, pieces[n].unknown, ways, view.step)
    else:
        crew.goals = {}
    if not pieces and go_home:
        _send_home(crew, old, poses, live, view.step, cfg)
    view.memory["finished"] = not pieces and not crew.goals


def _goal(old: Goal | None, place: np.ndarray, unknown: np.ndarray, ways: Ways, step: int) -> Goal:
    if old is not None and not old.done and np.hypot(*(old.place - place)) < SAME:
        return Goal(place, unknown, ways, old.since, old.born, old.least, old.at)
    return Goal(place, unknown, ways, step, step)


def _send_home(
    crew: Crew, old: dict[int, Goal], poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserExploreConfig
) -> None:
    """Everybody who is not back yet heads for its start, unless that was given up."""
    if crew.home is None or crew.ground is None:
        return
    for j in map(int, live):
        away = np.hypot(*(poses[j, :2] - crew.home[j])) > 2 * ARRIVED
        if away and not crew.barred(crew.home[j], step, cfg, waiting=False):
            ways = ways_to(crew.ground, crew.home[j], np.zeros((0, 2)), cfg)
            crew.goals[j] = _goal(old.get(j), crew.home[j], np.zeros((0, 2)), ways, step)
