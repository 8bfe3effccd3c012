"""Discs over everything unexplored, shared out as balanced tours and planned anew every few steps.

In an open field the first tours are improved as laps are: a robot that comes by known ground at the right time closes
a loop, which shortest tours do only by chance.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ...core.se2 import wrap_angle
from ...kernels.exploration.tours import balanced_tours, greedy_cover
from ..ground import FAR
from .belief import Explored, LandmarkBelief
from .config import STEERING_HEADING_COST, ExploreConfig
from .floor_plan import FloorPlan
from .laps import begin, drive, find_laps, follow, improve_tours, lap_steps, lap_task, mark_sure, revise
from .objective import ahead, given_up, nearest_unexplored, new_cells, next_target, offered, steer

# [m] of a disc of `coverage`: two thirds of the reach, so that passing its middle shows all of it
COVERAGE_RADIUS = 10.0
LOOP_RADIUS = 13.0  # [m] of a disc of `loop`: larger, so that fewer are left and a lap closes in time

COVERAGE_GAIN_WEIGHT = 0.12  # [m] that a newly seen cell is worth: a course over new ground may be a little longer
JOINT_SURE_MARGIN = 1.0  # [m] by which a cell must be within the reach to be surely seen: poses are estimates
JOINT_SURE_LEVELS = 4  # multiples of `JOINT_SURE_MARGIN`, after which what was seen least surely is looked at again
JOINT_MOST_ROBOT_STEPS = 800  # robots times steps beyond which planning would take minutes and `loop` takes over
COVERAGE_REPLAN_EVERY = 4  # [steps] between plans: two seconds, in which a robot sees what changes its tour
COVERAGE_TURN_COST = 2.0  # [m/rad] that turning towards the first disc counts as: half a turn takes about 4 s
COVERAGE_BALANCE = 0.3  # what the sum of all tours weighs beside the longest, those of `loop` too
LOOP_ARRIVED = 4.0  # [m] from a place of the tour at which it is reached: what lies there is in view by then
WALLS_STATION_SPACING = 2.0  # [m] between the places considered by `coverage` and `loop`


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its tour in an open field; elsewhere, and afterwards, what is left is covered.

    Asks the run to go on until the tours' time is over: their ends close loops.
    """
    memory = belief.memory
    if "tour_steps" not in memory:
        memory["tour_steps"] = lap_steps(belief, cfg.coverage, JOINT_MOST_ROBOT_STEPS)
        if memory["tour_steps"]:
            begin_tours(belief, poses, cfg)
    if not memory["tour_steps"]:
        return cover(belief, poses, cfg)
    memory["go_on_until"] = memory["tour_steps"]
    revise(belief, poses)

    def goal(j: int) -> np.ndarray | None:
        return follow(belief, j, poses[j]) if belief.step < memory["laps_end"] else None

    return drive(belief, poses, cfg, goal, lambda: cover(belief, poses, cfg))


def begin_tours(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> None:
    """Balanced tours over discs on the whole field, improved, are the laps from now on."""
    live = np.flatnonzero(belief.alive)
    every = np.argwhere(np.ones_like(belief.explored.fused))
    chosen = discs(belief, belief.explored.centres(every), cfg.coverage.tour_radius)
    tours, counts = balanced_tours(
        approach_cost(poses[live], chosen, COVERAGE_TURN_COST),
        np.linalg.norm(chosen[:, None] - chosen[None], axis=-1),
        np.zeros((len(live), len(chosen))),
        COVERAGE_BALANCE,
    )
    places: list[tuple[tuple[float, float], ...]] = [()] * len(belief.robots)
    for k, j in enumerate(live):
        places[j] = tuple((float(x), float(y)) for x, y in chosen[tours[k, : counts[k]]])
    task = lap_task(belief, poses, belief.memory["tour_steps"], cfg.coverage, cfg)
    begin(belief, task, improve_tours(task, tuple(places)))


def cover(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Every live robot heads for the first disc of its tour, on a course that shows it new ground on the way."""
    memory = belief.memory
    live, sharing = np.flatnonzero(belief.alive), np.flatnonzero(belief.alive | belief.away)
    among = (tuple(live), tuple(sharing))
    if belief.step >= memory.get("plan_until", -1) or memory.get("plan_for") != among:
        memory["goals"] = plan(belief, poses, sharing)
        memory["plan_until"] = belief.step + COVERAGE_REPLAN_EVERY
        memory["plan_for"] = among
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
    if j in targets and (ex.sees(j, targets[j]) or given_up(belief, j, targets[j])):
        del targets[j]
    if j not in targets and belief.stalled[j] >= cfg.objective.stall_steps:
        goal = next_target(belief, j, pose)
        if goal is not None:
            targets[j] = goal
    return targets.get(j)


def plan(belief: LandmarkBelief, poses: np.ndarray, live: np.ndarray) -> dict[int, np.ndarray]:
    """The next place (2,) for each of the robots `live`: the first disc of its tour, or the nearest unexplored cell."""
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.team()))
    if len(cells) == 0:
        return {}
    if belief.floor is not None:
        return plan_among_walls(belief, belief.floor, cells, poses, live)
    chosen = discs(belief, cells, COVERAGE_RADIUS)
    first = approach_cost(poses[live], chosen, COVERAGE_TURN_COST)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), COVERAGE_BALANCE)
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
    return np.asarray(controls[np.argmin(distance + STEERING_HEADING_COST * error - COVERAGE_GAIN_WEIGHT * gain)])


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


def choose_loop(
    belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig
) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its closed tour, skipping discs that are seen, then helps to cover what is left.

    Asks the run to go on to `loop_steps` after all landmarks were seen, unless every loop has closed before.
    """
    memory = belief.memory
    if "laps" not in memory:
        memory["home"] = poses[:, :2].copy()
        memory["laps"] = plan_laps(belief, poses)
    memory["go_on_until"] = 0 if _closed(belief, memory["laps"]) else loop_steps(belief, cfg)
    out = np.zeros((len(belief.robots), 2))
    idle = []
    for j in map(int, np.flatnonzero(belief.alive)):
        lap = memory["laps"][j]
        while lap and _passed(belief, j, poses[j], lap):
            lap.pop(0)
        if lap:
            out[j] = towards(belief, j, poses[j], lap[0], cfg)
        else:
            idle.append(j)
    if idle:
        rest = cover(belief, poses, cfg)
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


def plan_laps(belief: LandmarkBelief, poses: np.ndarray) -> dict[int, list[np.ndarray]]:
    """For each live robot the discs of its closed tour in order, its home last."""
    live = np.flatnonzero(belief.alive)
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.team()))
    if len(cells) == 0:
        return {int(j): [] for j in live}
    if belief.floor is not None:
        return laps_among_walls(belief, belief.floor, cells, poses, live)
    chosen = discs(belief, cells, LOOP_RADIUS)
    first = approach_cost(poses[live], chosen, COVERAGE_TURN_COST)
    between = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1)
    last = np.ascontiguousarray(np.linalg.norm(chosen[None] - poses[live][:, None, :2], axis=-1))
    tours, counts = balanced_tours(first, between, last, COVERAGE_BALANCE)
    return {int(j): [*(chosen[i] for i in tours[k, : counts[k]]), poses[j, :2].copy()] for k, j in enumerate(live)}


def _passed(belief: LandmarkBelief, j: int, pose: np.ndarray, lap: list[np.ndarray]) -> bool:
    """Whether the lap's next place was reached, or all its disc covers is seen; home itself must be reached."""
    if np.hypot(*(lap[0] - pose[:2])) < LOOP_ARRIVED:
        return belief.floor is None or bool(belief.floor.sees(pose[:2], lap[0][None], LOOP_ARRIVED)[0])
    if len(lap) == 1:
        return False
    ex = belief.explored
    cells = ex.centres(np.argwhere(~ex.known_to(j)))
    if belief.floor is not None:
        return not belief.floor.sees(lap[0], cells, LOOP_RADIUS).any()
    return len(cells) == 0 or bool(np.hypot(*(cells - lap[0]).T).min() > LOOP_RADIUS)


def _closed(belief: LandmarkBelief, laps: dict[int, list[np.ndarray]]) -> bool:
    return all(not laps[int(j)] for j in np.flatnonzero(belief.alive))


def choose_joint(
    belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig
) -> Float[np.ndarray, "r 2"]:
    """Each live robot follows its lap; when the laps' time is over, what is unseen is covered.

    Asks the run to go on until the laps' time is over: their ends close the loops. Where nothing is left to see, a
    robot follows the next one's lap.
    """
    memory = belief.memory
    if "lap_steps" not in memory:
        memory["lap_steps"] = lap_steps(belief, cfg.joint, JOINT_MOST_ROBOT_STEPS)
        if memory["lap_steps"]:
            task = lap_task(belief, poses, memory["lap_steps"], cfg.joint, cfg)
            begin(belief, task, find_laps(task))
    if not memory["lap_steps"]:
        return choose_loop(belief, poses, cfg)
    memory["go_on_until"] = memory["lap_steps"]
    _note(belief, poses)
    seen_by = [bool(belief.explored.known_to(j).all()) for j in range(len(belief.robots))]
    return drive(
        belief,
        poses,
        cfg,
        lambda j: _next(belief, j, poses[j], seen=seen_by[j]),
        lambda: _repair(belief, poses, cfg),
    )


def _note(belief: LandmarkBelief, poses: np.ndarray) -> None:
    """Marks cells as seen with room to spare, a raster for each margin within the sensor's reach, growing.

    Poses are estimates: what was seen at the edge of the reach alone may not have been seen at all.
    """
    sure = belief.memory.setdefault("sure", np.zeros((JOINT_SURE_LEVELS, *belief.explored.fused.shape), dtype=bool))
    for k, cells in enumerate(sure):
        mark_sure(belief, poses, (k + 1) * JOINT_SURE_MARGIN, cells)


def _repair(belief: LandmarkBelief, poses: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Coverage of what is unseen; when all was seen and yet something missed, of what was least surely seen first."""
    memory, ex = belief.memory, belief.explored
    if ex.sweeps > memory.get("swept", 1):
        for cells in memory["sure"]:
            again = cells | ex.team()
            if not again.all():
                shadow = Explored(ex.lower, ex.cell, again, np.zeros_like(ex.pending), np.zeros_like(ex.backlog))
                return cover(replace(belief, explored=shadow), poses, cfg)
        memory["sure"][:] = False
        memory["swept"] = ex.sweeps
    return cover(belief, poses, cfg)


def _next(belief: LandmarkBelief, j: int, pose: np.ndarray, *, seen: bool) -> np.ndarray | None:
    """Where robot j goes: the next place of its lap while that is worth it, or of another's when all is seen."""
    memory = belief.memory
    goal, lap = follow(belief, j, pose), memory["laps"][j]
    late = belief.step >= memory["laps_end"]
    if seen and goal is None:
        turns = memory.setdefault("turns", {})
        turns[j] = turns.get(j, 0) + 1
        other = memory["found"][(j + turns[j]) % len(memory["found"])]
        nearest = int(np.argmin(np.hypot(*(other - pose[:2]).T)))
        lap.extend(np.roll(other, -nearest, axis=0))
        return np.asarray(lap[0])
    return goal if seen or not late else None


@dataclass(slots=True)
class Stations:
    """Places (k, 2) all over the ground, its cells at (k, 2), and what each sees within `radius`: cells (n, k).

    Remembers the paths (k,) [m] from the stations asked for to all others.
    """

    places: Float[np.ndarray, "k 2"]
    at: Int[np.ndarray, "k 2"]
    sees: Bool[np.ndarray, "n k"]
    _ways: dict[int, np.ndarray] = field(default_factory=dict)

    def ways(self, floor: FloorPlan, chosen: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
        """Length [m] of the shortest path between each two of the `chosen` stations."""
        new = [int(k) for k in chosen if int(k) not in self._ways]
        if new:
            for k, d in zip(new, floor.ground.distances(self.places[new]), strict=True):
                self._ways[k] = np.minimum(d[self.at[:, 0], self.at[:, 1]], FAR)
        return np.stack([self._ways[int(k)][chosen] for k in chosen])


def stations(belief: LandmarkBelief, floor: FloorPlan, radius: float) -> Stations:
    """The stations of this run for discs of `radius`, made once."""
    known: dict[float, Stations] = belief.memory.setdefault("stations", {})
    if radius not in known:
        step = max(1, round(WALLS_STATION_SPACING / floor.ground.cell))
        cells = np.argwhere(floor.ground.free)
        middle = np.abs(cells % step - (step - 1) / 2).sum(axis=1)
        order = np.lexsort((middle, *(cells // step).T))
        _, first = np.unique(cells[order] // step, axis=0, return_index=True)
        at = cells[order][first]
        places = floor.ground.centres(at)
        centres = belief.explored.centres(np.argwhere(floor.field))
        sees = np.stack([floor.sees(p, centres, radius) for p in places], axis=1)
        known[radius] = Stations(places, at, sees)
    return known[radius]


def cover_among_walls(
    belief: LandmarkBelief, floor: FloorPlan, cells: Float[np.ndarray, "n 2"], radius: float
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Few stations (k,) that see all `cells`, the one that sees most first, and where (k, 2) to go for each.

    That is the place from which the middle one of the cells it newly sees is seen best.
    """
    have = stations(belief, floor, radius)
    row = np.full(floor.field.shape, -1)
    row[floor.field] = np.arange(int(floor.field.sum()))
    at = np.floor((cells - floor.lower) / floor.cell).astype(int)
    sees = have.sees[row[at[:, 1], at[:, 0]]]
    open_ = sees.any(axis=1)
    gain = sees.sum(axis=0)
    groups: list[tuple[int, np.ndarray]] = []
    while open_.any():
        best = int(np.argmax(gain))
        group = np.flatnonzero(open_ & sees[:, best])
        open_[group] = False
        gain = gain - sees[group].sum(axis=0)
        groups.append((best, group))
    far = np.flatnonzero(~sees.any(axis=1))  # seen from farther away alone: grouped by the place they are seen from
    if len(far):
        _, station = cKDTree(have.places).query(floor.view_of(cells[far]))
        groups += [(int(k), far[station == k]) for k in np.unique(station)]
    chosen, goals = [], []
    for best, group in groups:
        middle = cells[group].mean(axis=0)
        nearest = group[int(np.argmin(np.hypot(*(cells[group] - middle).T)))]
        chosen.append(best)
        goals.append(floor.view_of(cells[nearest][None])[0])
    return np.array(chosen), np.array(goals)


def plan_among_walls(
    belief: LandmarkBelief, floor: FloorPlan, cells: np.ndarray, poses: np.ndarray, live: np.ndarray
) -> dict[int, np.ndarray]:
    """The next place (2,) for each live robot: the first of its tour, or the nearest from which new cells are seen."""
    chosen, goals = cover_among_walls(belief, floor, cells, COVERAGE_RADIUS)
    first = _approach(floor, poses[live], goals)
    between = stations(belief, floor, COVERAGE_RADIUS).ways(floor, chosen)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), COVERAGE_BALANCE)
    return {int(j): goals[tours[k, 0] if counts[k] else int(np.argmin(first[k]))] for k, j in enumerate(live)}


def laps_among_walls(
    belief: LandmarkBelief, floor: FloorPlan, cells: np.ndarray, poses: np.ndarray, live: np.ndarray
) -> dict[int, list[np.ndarray]]:
    """For each live robot the places of its closed tour in order, its home last."""
    chosen, _ = cover_among_walls(belief, floor, cells, LOOP_RADIUS)
    have = stations(belief, floor, LOOP_RADIUS)
    places = have.places[chosen]
    first = _approach(floor, poses[live], places)
    last = _ways(floor, poses[live], places)
    tours, counts = balanced_tours(first, have.ways(floor, chosen), last, COVERAGE_BALANCE)
    return {int(j): [*(places[i] for i in tours[k, : counts[k]]), poses[j, :2].copy()] for k, j in enumerate(live)}


def _ways(floor: FloorPlan, poses: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "r n"]:
    """Length [m] of the path from each pose to each place; FAR where none leads."""
    at = floor.ground.cells(places)
    return np.ascontiguousarray(np.minimum(floor.from_places(poses[:, :2])[:, at[:, 0], at[:, 1]], FAR))


def _approach(floor: FloorPlan, poses: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "r n"]:
    """The same with what turning towards the place costs."""
    d = places[None, :, :] - poses[:, None, :2]
    angle = np.abs(wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - poses[:, None, 2]))
    return np.asarray(_ways(floor, poses, places) + COVERAGE_TURN_COST * angle)
