"""The planners for laser worlds by name: each shares out the frontiers its own way, all drive alike and give way."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...core import se2
from ...core.records import frozen
from ...core.se2 import wrap_angle
from ...kernels.exploration.tours import balanced_tours, improve_tours
from ...kernels.exploration.wavefront import NO_LIMIT, STRAIGHT, arc_clearance, arc_points, spread
from ..ground import FAR, Ground
from .config import ARCS_APART, LaserPlan
from .frontiers import ROOMY, Frontier, MappedGround, disc_mask, frontiers, mapped_ground, pockets
from .mission import (
    GOALS_SAME,
    ClearCostToGo,
    Goal,
    LaserBelief,
    PlannerState,
    YieldPlace,
    planner_state_of,
    route_to,
    with_parked,
)

REVERSE_SPEED = 1 / 3  # share of the top speed, backwards, to leave a tight spot
FOLLOWER_HEADING_COST = 0.8  # [m/rad] that a wrong heading counts as
REVERSE_COST = 0.25  # [m] that driving backwards counts as: turning round is better where there is room
SHELL = 0.1  # [m] of their distance by which points of unknown robots are taken together
ARC_SAMPLE = 0.02  # [m] between the samples of an arc: half of `GUARD`
GUARD = 0.04  # [m] beyond the radius that a driven arc keeps from every point of the present scan

GOALS_SEEN_SHARE = 0.8  # of a goal's unknown cells after which it is done: the rest is noise of the walls
GOALS_SPARE_WAY = 20.0  # [m] farther than needed that paths to a goal are looked for, so that detours are known
GOALS_PATIENCE_FACTOR = 10  # times `GOALS_PATIENCE` after which a goal is put off however often it came nearer
FOLLOW_HEADING_NEAR = 0.3  # [m] from the place, and less nearer by
FOLLOW_CLOSENESS_COST = 0.3  # [m] that a metre of clearance below `ROOMY` counts as
WAY_NEXT_WAY = 2.0  # [m] of a robot's path on which another stands in its way
WAY_CLEAR_WAY = 6.0  # [m] of the other's path that a waiting robot keeps clear of: through a door and on
WAY_WAIT_STEPS = 40  # [steps] that a robot waits aside at most
WAY_STUCK_STEPS = 30  # [steps] about one place after which a robot tries something else
WAY_RETRY_FROM = 1.0  # [m] of path at least to the place it tries again from
WAY_RETRY_TO = 4.0  # [m] of path at most to that place
WAY_RETRY_STEPS = 15  # [steps] that getting there may take
WAY_RETRY_ARRIVED = 0.3  # [m] from that place at which it is reached
WAY_LEAVING_STEPS = 3  # [steps] of standing still up to which a robot with a goal is about to leave
SHARED_SAME_PIECE = 1.5  # [m] from the goal that was made of it within which what is left of a piece lies
SHARED_ON_THE_WAY = 1.0  # [m], a detour that small is none
PLAN_REPLAN_SOONEST = 4  # [steps] between plans at least, when a robot has nothing to do
PLAN_W_WAY = 0.5  # what 20 m of path cost beside these
GOALS_ARRIVED = 0.35  # [m] from a goal at which a robot is there: a cell and a half of the planning grid
GOALS_PROGRESS = 0.2  # [m] nearer that counts as progress: a cell of the planning grid
FOLLOW_LOOKAHEAD = 2.0  # [m] of path that is looked ahead: three seconds at full speed
WAY_MEETING = 2.5  # [m] apart beyond which robots do not meet
WAY_BESIDE = 0.1  # [m] beyond what two robots need to pass, where a robot waits
WAY_PARTED = 1.5  # times `WAY_MEETING` apart beyond which nobody waits for the other any more
SHARED_TURN_COST = 0.6  # [m/rad] that turning towards a goal counts as: what the robot would drive meanwhile
SHARED_BALANCE = 0.3  # what the sum of all tours weighs beside the longest
SHARED_STRETCH = 3  # places of a tour that are moved together to better it, at most
PLAN_REPLAN_EVERY = 12  # [steps] between plans: six seconds, in which a robot sees a new room
PLAN_KEEP = 2.0  # [m] that another goal must be nearer before a robot changes its mind
PLAN_SERVICE = 2.0  # [m] that looking round at a goal counts as
GOALS_PATIENCE = 40  # [steps] without coming nearer after which a goal is put off
GOALS_LOOK = 4  # [steps] at a goal that nothing new comes of after which it is put off


@cache
def candidate_commands(cfg: LaserPlan) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 3"]]:
    """All (v, w) a robot chooses from: standing still first, then turning on the spot, then faster; and where each
    ends in the robot's frame.
    """
    turns = cfg.turn * np.array([0.0, *(s * k / 10 for k in range(1, 11) for s in (1, -1))])
    speeds = cfg.speed * np.array([0.0, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1.0])
    ahead = np.array([(v, w) for v in speeds for w in turns])
    back = np.array([(-REVERSE_SPEED * cfg.speed, w) for w in turns[::4]])
    commands = frozen(np.concatenate([ahead, back]))
    return commands, frozen([arc_points(v, w, cfg.period, 1)[1] for v, w in commands])


def collision_free(
    commands: Float[np.ndarray, "m 2"], points: Float[np.ndarray, "k 2"], least: float, cfg: LaserPlan
) -> tuple[Bool[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Which arcs keep `least` [m] from every point (robot's frame), or come no nearer than the robot stands; and how
    near each comes (m,).
    """
    stride = cfg.speed * cfg.period
    near = points[np.hypot(*points.T) < least + stride + ROOMY]
    clearance = arc_clearance(commands, cfg.period, np.ascontiguousarray(near), ARC_SAMPLE)
    still = np.hypot(*near.T).min() if len(near) else np.inf
    return clearance >= min(least, still) - 1e-9, clearance


def steer(
    pose: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "2"] | None,
    scan: Float[np.ndarray, "k 2"],
    others: Float[np.ndarray, "n 2"],
    cfg: LaserPlan,
    moving: Float[np.ndarray, "m 2"] | None = None,
) -> Float[np.ndarray, "2"]:
    """The allowed command that heads for `target` soonest; stands still without one.

    scan: points in the robot's frame, which no arc comes nearer than radius + guard; others: places in the map where
    other robots are or will be during this step, which the robot's middle comes no nearer than 2 radii + apart; moving:
    points of robots that are not known, to which no arc leads more than half the way: so may they.
    """
    if target is None:
        return np.zeros(2)
    commands, ends = candidate_commands(cfg)
    free, clearance = collision_free(commands, scan, cfg.radius + GUARD, cfg)
    if len(others):
        free &= collision_free(commands, se2.act(se2.inverse(pose), others), 2 * cfg.radius + ARCS_APART, cfg)[0]
    if moving is not None and len(moving):
        shell = np.ceil((np.hypot(*moving.T) - cfg.radius) / SHELL).astype(np.int64)
        for k in np.unique(shell[shell <= np.ceil(2.0 * cfg.speed * cfg.period / SHELL)]).tolist():
            least = cfg.radius + max(GUARD, 0.5 * k * SHELL)
            free &= collision_free(commands, moving[shell == k], least, cfg)[0]
    goal = se2.act(se2.inverse(pose), target)
    d = goal - ends[:, :2]
    distance = np.hypot(d[:, 0], d[:, 1])
    error = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - ends[:, 2]))
    error = error * np.minimum(1.0, distance / FOLLOW_HEADING_NEAR)
    tight = np.clip(ROOMY - clearance, 0.0, ROOMY)
    backwards = REVERSE_COST * (commands[:, 0] < 0.0)
    cost = np.where(free, distance + FOLLOWER_HEADING_COST * error + FOLLOW_CLOSENESS_COST * tight + backwards, np.inf)
    return np.asarray(commands[np.argmin(cost)])


def predicted_path(
    pose: Float[np.ndarray, "3"], command: Float[np.ndarray, "2"], cfg: LaserPlan
) -> Float[np.ndarray, "n 2"]:
    """Places (n, 2) along the arc of one step, in the frame of `pose`'s map, start and end among them."""
    arc = arc_points(float(command[0]), float(command[1]), cfg.period, 6)
    return np.asarray(se2.act(pose, arc[:, :2]))


def priority_order(state: PlannerState, live: np.ndarray) -> list[int]:
    """Live robots by who goes first: by rank, those with nothing to do last."""
    return sorted(map(int, live), key=lambda j: (j not in state.goals and j not in state.yielding, state.priority[j]))


def current_route(state: PlannerState, j: int) -> ClearCostToGo | None:
    """The route robot j follows now: to where it lets another pass, else to its goal."""
    if j in state.yielding:
        return state.yielding[j].route
    return state.goals[j].route if j in state.goals else None


def resolve_conflicts(state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserPlan) -> None:
    """Whoever stands in the way of a robot that goes first gets a place aside; who has waited long enough goes on."""
    _end_waiting(state, poses, live, step, cfg)
    _get_unstuck(state, poses, live, step, cfg)
    ranked = priority_order(state, live)
    near = 2 * cfg.radius + ARCS_APART
    for a, i in enumerate(ranked):
        for k in ranked[a + 1 :]:
            if k in state.yielding or np.hypot(*(poses[i, :2] - poses[k, :2])) > WAY_MEETING:
                continue
            if not _in_way(state, poses, i, k, near, WAY_NEXT_WAY):
                continue
            leaving = (
                k in state.goals
                and state.still[k] < WAY_LEAVING_STEPS
                and not _in_way(state, poses, k, i, near, WAY_NEXT_WAY)
            )
            if not leaving and not _yield_to(state, poses, k, i, step, cfg) and i not in state.yielding:
                state.priority[i], state.priority[k] = state.priority[k], state.priority[i]
                _yield_to(state, poses, i, k, step, cfg)


def _in_way(state: PlannerState, poses: np.ndarray, i: int, k: int, near: float, ahead: float) -> bool:
    """Whether robot k stands on the next part of robot i's path."""
    route = current_route(state, i)
    way = route.along(poses[i, :2], ahead) if route is not None else np.zeros((0, 2))
    return len(way) > 0 and float(np.hypot(*(way - poses[k, :2]).T).min()) < near


def _yield_to(state: PlannerState, poses: np.ndarray, k: int, i: int, step: int, cfg: LaserPlan) -> bool:
    """Robot k goes to the nearest place beside robot i's path; whether there is one."""
    ground, route = state.ground, current_route(state, i)
    if ground is None or route is None:
        return False
    way = np.vstack([poses[i : i + 1, :2], route.along(poses[i, :2], WAY_CLEAR_WAY)])
    near = 2 * cfg.radius + ARCS_APART
    others = np.array([p[:2] for j, p in enumerate(poses) if j not in (i, k)]).reshape(-1, 2)
    weight = ground.weight.copy()
    weight[disc_mask(ground.grid, poses[i : i + 1, :2], near)] = 0
    if len(others):
        weight[disc_mask(ground.grid, others, near)] = 0
    left = Ground(weight, ground.lower, ground.cell, ground.snap)
    cost = left.cost_to_go(left.cells(poses[k : k + 1, :2])).cost
    cost[disc_mask(ground.grid, way, near + WAY_BESIDE)] = -1
    cells = np.argwhere(cost >= 0)
    if len(cells) == 0:
        return False
    best = cells[np.argmin(cost[tuple(cells.T)])]
    place = ground.grid.centres(best[None])[0]
    state.yielding[k] = YieldPlace(place, route_to(ground, place, poses[i : i + 1, :2], cfg), i, step + WAY_WAIT_STEPS)
    return True


def _end_waiting(state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserPlan) -> None:
    near = 2 * cfg.radius + ARCS_APART
    for k, waiting in list(state.yielding.items()):
        i = waiting.whom
        if i == k:
            if step >= waiting.until or np.hypot(*(waiting.place - poses[k, :2])) < WAY_RETRY_ARRIVED:
                del state.yielding[k]
            continue
        gone = i not in live or np.hypot(*(poses[i, :2] - poses[k, :2])) > WAY_PARTED * WAY_MEETING
        passed = not _in_way(state, poses, i, k, near, WAY_CLEAR_WAY) and not _goal_blocked(state, poses, k, i, near)
        if gone or passed or step >= waiting.until:
            del state.yielding[k]
            if not gone and not passed and state.priority[k] > state.priority[i]:
                state.priority[i], state.priority[k] = state.priority[k], state.priority[i]


def _goal_blocked(state: PlannerState, poses: np.ndarray, k: int, i: int, near: float) -> bool:
    """Whether robot i stands on the next part of robot k's path to its goal."""
    if k not in state.goals:
        return False
    way = state.goals[k].route.along(poses[k, :2], WAY_NEXT_WAY)
    return len(way) > 0 and float(np.hypot(*(way - poses[i, :2]).T).min()) < near


def _get_unstuck(state: PlannerState, poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserPlan) -> None:
    """Who has a goal and yet stays about one place for long goes some other way first; ranks are drawn anew.

    The lots are the same in the same run.
    """
    ground = state.ground
    for j in map(int, live):
        if ground is None or j not in state.goals or j in state.yielding or step - state.about[j, 2] < WAY_STUCK_STEPS:
            continue
        rng = np.random.default_rng([step, j])
        state.about[j, 2] = step
        state.priority = rng.permutation(len(state.priority)).astype(float)
        metres = ground.cost_to_go(ground.cells(poses[j : j + 1, :2])).metres
        around = (metres > WAY_RETRY_FROM) & (metres < WAY_RETRY_TO)
        cells = np.argwhere(around & (ground.weight == ground.weight[around].min(initial=255)))
        if len(cells):
            place = ground.grid.centres(rng.choice(cells)[None])[0]
            state.yielding[j] = YieldPlace(
                place, route_to(ground, place, np.zeros((0, 2)), cfg), j, step + WAY_RETRY_STEPS
            )


RING = np.array([(y, x) for y in range(-2, 3) for x in range(-2, 3) if max(abs(y), abs(x)) == 2])


@dataclass(frozen=True, slots=True)
class AllocationProblem:
    """Pieces of frontier and how far they are. robots: (m,) who may go; first: (m, n) [m] from each robot, its turn
    towards the piece counted; between: (n, n) [m]; FAR where no path leads; held: robot -> piece it heads for already.
    """

    pieces: list[Frontier]
    robots: tuple[int, ...]
    first: Float[np.ndarray, "m n"]
    between: Float[np.ndarray, "n n"]
    poses: Float[np.ndarray, "m 3"]
    ground: MappedGround
    held: dict[int, int]


Allocator = Callable[[AllocationProblem, LaserPlan], dict[int, int]]


def allocation_problem(
    ground: MappedGround,
    pieces: list[Frontier],
    state: PlannerState,
    poses: np.ndarray,
    live: np.ndarray,
    cfg: LaserPlan,
) -> AllocationProblem:
    """All paths between live robots and pieces, over cells twice as large: shares need no exact lengths."""
    weight = halved(with_parked(ground, parked(state, poses, live), cfg).weight)
    metre = 2 * ground.grid.resolution / STRAIGHT
    places = np.vstack([poses[live, :2], *(f.place[None] for f in pieces)])
    fine = ground.cells(places)
    cells = fine // 2
    m = len(live)
    costs = [spread(weight, cells[m + n : m + n + 1], NO_LIMIT) for n in range(len(pieces))]
    cost = np.array([c[tuple(cells.T)] for c in costs], dtype=float)
    metres = np.where((cost >= 0) & (fine[:, 0] >= 0), cost * metre, FAR).T
    first = metres[:m].copy()
    for r, j in enumerate(live):
        away = departures(costs, cells[r])
        first[r] += np.where(
            np.isfinite(away), SHARED_TURN_COST * np.abs(wrap_angle(np.nan_to_num(away) - poses[j, 2])), 0.0
        )
    return AllocationProblem(
        pieces, tuple(map(int, live)), first, metres[m:], poses[live], ground, _held(state, pieces)
    )


def parked(state: PlannerState, poses: np.ndarray, live: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Places of live robots that stand idle: they are gone round where that is possible."""
    return np.asarray(poses[[j for j in live if j not in state.goals and state.still[j] > 5], :2])


def halved(weight: np.ndarray) -> np.ndarray:
    """`weight` over cells twice as large: blocked where all four are, else the mean of those that are not.

    Walls stay shut, since a robot's width is blocked on both sides of them.
    """
    padded = np.pad(weight, [(0, n % 2) for n in weight.shape]).astype(np.uint16)
    four = np.stack([padded[a::2, b::2] for a in (0, 1) for b in (0, 1)])
    return np.asarray((four.sum(axis=0) / np.maximum((four > 0).sum(axis=0), 1)).round(), dtype=np.uint8)


def departures(costs: list[np.ndarray], cell: np.ndarray) -> Float[np.ndarray, " n"]:
    """Direction [rad] (n,) in which the path down each of `costs` leaves `cell`; NaN where it is there or unreached."""
    rows, cols = costs[0].shape
    ring = cell + RING
    inside = np.all((ring >= 0) & (ring < (rows, cols)), axis=1)
    y, x = ring[inside].T
    around = np.array([c[y, x] for c in costs], dtype=float)
    here = np.array([c[tuple(cell)] for c in costs], dtype=float)
    around[around < 0] = np.inf
    best = np.argmin(around, axis=1)
    angle = np.arctan2(*RING[inside][best].T.astype(float))
    return np.where((here > 0) & (around[np.arange(len(costs)), best] < here), angle, np.nan)


def _held(state: PlannerState, pieces: list[Frontier]) -> dict[int, int]:
    """Robot -> what is left of the piece it heads for: the one with unknown cells nearest to its goal."""
    out: dict[int, int] = {}
    for j, goal in state.goals.items():
        away = [np.hypot(*(f.unknown - goal.place).T).min() for f in pieces]
        if not goal.done and away and min(away) < SHARED_SAME_PIECE:
            out[j] = int(np.argmin(away))
    return out


def keep_commitments(problem: AllocationProblem, chosen: dict[int, int]) -> dict[int, int]:
    """`chosen`, but who is on the way to a piece goes on, unless another robot does it, or the new one is nearer by
    `PLAN_KEEP` or lies on the way. Since every change of mind brings a goal nearer there is no driving to and fro.
    """
    out = dict(chosen)
    row = {j: r for r, j in enumerate(problem.robots)}
    for j, h in problem.held.items():
        n = out.get(j)
        far = problem.first[row[j], h]
        if n == h or j not in row or far >= FAR / 2:
            continue
        who = next((i for i in out if i != j and out[i] == h), None)
        if who is not None and problem.first[row[who], h] < far:
            continue
        if n is not None:
            to = problem.first[row[j], n]
            if to < far - PLAN_KEEP or to + problem.between[n, h] < far + SHARED_ON_THE_WAY:
                continue
        out[j] = h
        if who is not None and n is not None:
            out[who] = n
        elif who is not None:
            del out[who]
    return out


def by_tours(problem: AllocationProblem, cfg: LaserPlan) -> dict[int, int]:
    """Robot -> piece: the first of its tour, the tours short in the longest and then in the sum."""
    del cfg
    first, between = (np.ascontiguousarray(cost + PLAN_SERVICE) for cost in (problem.first, problem.between))
    tours, counts = balanced_tours(first, between, np.zeros_like(first), SHARED_BALANCE)
    improve_tours(first, between, tours, counts, SHARED_STRETCH)
    chosen = {j: int(tours[r, 0]) for r, j in enumerate(problem.robots) if counts[r]}
    return {j: n for j, n in chosen.items() if problem.first[problem.robots.index(j), n] < FAR / 2}


def nearest_first(problem: AllocationProblem, cfg: LaserPlan) -> dict[int, int]:
    """Robot -> piece: the shortest path of all first; a piece goes to one robot."""
    del cfg
    left = problem.first.copy()
    out: dict[int, int] = {}
    while left.size and left.min() < FAR / 2:
        r, n = np.unravel_index(np.argmin(left), left.shape)
        out[problem.robots[r]] = int(n)
        left[r], left[:, n] = FAR, FAR
    return out


def by_objective(w_accuracy: float) -> Allocator:
    """Allocates by `J = w1 walls + w2 area + w3 apart - way`, each in [0, 1], one robot after the other."""

    def allocate(problem: AllocationProblem, cfg: LaserPlan) -> dict[int, int]:
        walls, area = walls_and_area(problem, cfg)
        out: dict[int, int] = {}
        taken: list[np.ndarray] = []
        for r, j in enumerate(problem.robots):
            J = w_accuracy * walls + cfg.w_area * area - PLAN_W_WAY * problem.first[r] / 20.0
            others = [*taken, *problem.poses[r + 1 :, :2]]
            if others:
                d = np.array([[np.hypot(*(f.place - o)) for o in others] for f in problem.pieces])
                J = J + cfg.w_apart * np.minimum(d / (2 * cfg.reach), 1.0).mean(axis=1)
                J = J - np.array(
                    [1.0 if any(np.hypot(*(f.place - o)) < GOALS_SAME for o in taken) else 0.0 for f in problem.pieces]
                )
            J = np.where(problem.first[r] < FAR / 2, J, -np.inf)
            if len(J) and np.isfinite(J.max()):
                best = int(np.argmax(J))
                out[j] = best
                taken.append(problem.pieces[best].place)
        return out

    return allocate


def walls_and_area(problem: AllocationProblem, cfg: LaserPlan) -> tuple[np.ndarray, np.ndarray]:
    """For each piece, in [0, 1]: known walls around it, which a scan there can be matched to, and unknown ground."""
    grid = problem.ground.grid
    side = 2 * int(0.5 * cfg.reach / grid.resolution) + 1
    cells = grid.cells(np.array([f.place for f in problem.pieces]).reshape(-1, 2))
    terms = [
        ndimage.uniform_filter(mask.astype(np.float32), side, mode="constant")[tuple(cells.T)]
        for mask in (grid.occupied, grid.unknown & problem.ground.fits)
    ]
    return tuple(x / x.max() if x.size and x.max() > 0 else x for x in terms)


def choose_goals(
    belief: LaserBelief,
    poses: Float[np.ndarray, "r 3"],
    cfg: LaserPlan,
    allocate: Allocator,
    *,
    go_home: bool = False,
) -> PlannerState:
    """Where each robot heads by `allocate`, for robots that find their ways themselves; sets the memory as `drive`."""
    state = planner_state_of(belief, poses)
    live = np.flatnonzero(belief.alive)
    _tidy(state, belief, poses, live)
    if _due(state, belief.step, live):
        _plan(state, belief, poses, live, cfg, allocate, go_home=go_home)
    belief.memory["goals"] = {j: goal.place for j, goal in state.goals.items()}
    return state


def drive(
    belief: LaserBelief,
    poses: Float[np.ndarray, "r 3"],
    cfg: LaserPlan,
    allocate: Allocator,
    *,
    go_home: bool = False,
) -> Float[np.ndarray, "r 2"]:
    """Commands (M, 2) of a team whose frontiers are shared out by `allocate`.

    Sets memory["finished"] when no frontier is left that a robot can get to (and, with `go_home`, all are back);
    memory["goals"]: {robot: place}; memory["given_up"], memory["pockets"]: (n, 2) places [m].
    """
    state = choose_goals(belief, poses, cfg, allocate, go_home=go_home)
    live = np.flatnonzero(belief.alive)
    resolve_conflicts(state, poses, live, belief.step, cfg)
    out = np.zeros((len(belief.robots), 2))
    will_be = {int(j): poses[j : j + 1, :2] for j in live}
    for j in priority_order(state, live):
        route = current_route(state, j)
        target = None if route is None else route.target(poses[j, :2], FOLLOW_LOOKAHEAD)
        if target is not None and np.hypot(*(target - poses[j, :2])) < 0.5 * cfg.resolution:
            target = None
        others = np.concatenate([np.zeros((0, 2)), *(p for k, p in will_be.items() if k != j)])
        out[j] = steer(poses[j], target, belief.scans[j], others, cfg, belief.moving[j])
        will_be[j] = predicted_path(poses[j], out[j], cfg)
    return out


def _tidy(state: PlannerState, belief: LaserBelief, poses: np.ndarray, live: np.ndarray) -> None:
    """Goals that are seen are done; those reached for nothing or out of reach for long are put off."""
    state.yielding = {j: place for j, place in state.yielding.items() if j in live}
    state.goals = {j: goal for j, goal in state.goals.items() if j in live}
    for j, goal in list(state.goals.items()):
        left = float(goal.route.metres_from(poses[j : j + 1, :2])[0])
        if left < goal.least - GOALS_PROGRESS:
            goal.least, goal.since = left, belief.step
        elif j in state.yielding:
            goal.since += 1
        if left < GOALS_ARRIVED and goal.at is None:
            goal.at = belief.step
        if (
            len(goal.unknown)
            and (belief.grid.state[tuple(belief.grid.cells(goal.unknown).T)] >= 0).mean() >= GOALS_SEEN_SHARE
        ):
            goal.done = True
        elif _in_vain(goal, belief.step):
            state.defer(goal.place, belief.step)
            del state.goals[j]


def _in_vain(goal: Goal, step: int) -> bool:
    """Whether nothing new comes of standing at the goal, or the robot does not get there."""
    if goal.at is not None:
        return len(goal.unknown) > 0 and step - goal.at >= GOALS_LOOK
    return step - goal.since > GOALS_PATIENCE or step - goal.born > GOALS_PATIENCE_FACTOR * GOALS_PATIENCE


def _due(state: PlannerState, step: int, live: np.ndarray) -> bool:
    age = step - state.planned
    idle = any(j not in state.goals or state.goals[j].done for j in live)
    return state.planned_for != tuple(live) or age >= PLAN_REPLAN_EVERY or (idle and age >= PLAN_REPLAN_SOONEST)


def _plan(
    state: PlannerState,
    belief: LaserBelief,
    poses: np.ndarray,
    live: np.ndarray,
    cfg: LaserPlan,
    allocate: Allocator,
    *,
    go_home: bool,
) -> None:
    """New goals for all live robots; who keeps its goal keeps its patience."""
    dead = poses[~belief.alive, :2]
    ground = mapped_ground(belief.grid, poses[live, :2], dead, cfg)
    state.ground, state.planned, state.planned_for = ground, belief.step, tuple(live)
    open_pieces = [f for f in frontiers(ground) if not state.barred(f.place, belief.step, waiting=False)]
    pieces = [f for f in open_pieces if not state.barred(f.place, belief.step)] or open_pieces
    belief.memory["given_up"] = state.given_up()
    belief.memory["pockets"] = pockets(ground)
    old = state.goals
    if pieces:
        problem = allocation_problem(ground, pieces, state, poses, live, cfg)
        shared = keep_commitments(problem, allocate(problem, cfg))
        stand = parked(state, poses, live)
        state.goals = {}
        for j, n in shared.items():
            far = GOALS_SPARE_WAY + 2.0 * float(problem.first[problem.robots.index(j), n])
            route = route_to(ground, pieces[n].place, stand, cfg, far)
            state.goals[j] = _goal(
                old.get(j), Goal(pieces[n].place, pieces[n].unknown, route, belief.step, belief.step)
            )
    else:
        state.goals = {}
    if not pieces and go_home:
        _send_home(state, old, poses, live, belief.step, cfg)
    belief.memory["finished"] = not pieces and not state.goals


def _goal(old: Goal | None, new: Goal) -> Goal:
    """The new goal, with the old one's patience where it is the same place."""
    if old is not None and not old.done and np.hypot(*(old.place - new.place)) < GOALS_SAME:
        return replace(new, since=old.since, born=old.born, least=old.least, at=old.at)
    return new


def _send_home(
    state: PlannerState, old: dict[int, Goal], poses: np.ndarray, live: np.ndarray, step: int, cfg: LaserPlan
) -> None:
    """Everybody who is not back yet heads for its start, unless that was given up."""
    if state.home is None or state.ground is None:
        return
    for j in map(int, live):
        away = np.hypot(*(poses[j, :2] - state.home[j])) > 2 * GOALS_ARRIVED
        if away and not state.barred(state.home[j], step, waiting=False):
            route = route_to(state.ground, state.home[j], np.zeros((0, 2)), cfg)
            state.goals[j] = _goal(old.get(j), Goal(state.home[j], np.zeros((0, 2)), route, step, step))


def coverage(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserPlan) -> Float[np.ndarray, "r 2"]:
    """Balanced tours over all frontiers by the length of the path; every robot heads for the first of its tour."""
    return drive(belief, poses, cfg, by_tours)


def nearest(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserPlan) -> Float[np.ndarray, "r 2"]:
    """Every robot heads for the nearest frontier that no nearer robot has taken: what the others are measured by."""
    return drive(belief, poses, cfg, nearest_first)


def paper(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserPlan) -> Float[np.ndarray, "r 2"]:
    """Every robot heads for the frontier of largest J: walls to hold on to, new area, distance from the others."""
    return drive(belief, poses, cfg, by_objective(cfg.w_accuracy))


def area(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserPlan) -> Float[np.ndarray, "r 2"]:
    """`paper` without its accuracy term."""
    return drive(belief, poses, cfg, by_objective(0.0))


def loop(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserPlan) -> Float[np.ndarray, "r 2"]:
    """`coverage`, then every robot drives back to its start, so that loops close."""
    return drive(belief, poses, cfg, by_tours, go_home=True)
