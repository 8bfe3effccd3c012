"""The paper's planner: each robot's best control under accuracy, new area, and distance to the others' submaps.

And from a place to go to the control that goes there, among those that stay in the field.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from ...core import se2
from ...core.records import owned
from ...core.se2 import wrap_angle
from ...fusion.handover import pose_in_map
from ...kernels.exploration.objective import MotionAndSight, expected_uncertainty, map_uncertainty, unexplored_cells
from ...kernels.walls.segments import Sector, distance_of_moves
from ...kernels.walls.sight import unexplored_in_sight
from ...landmarks.landmark_map import GlobalMap, Submap
from ...landmarks.submap_slam import move
from .belief import LandmarkBelief
from .config import STEERING_HEADING_COST, WALLS_COMFORT, ExploreConfig
from .floor_plan import FloorPlan

PUT_OFF_AFTER = 60  # [steps] after which a target that was not seen is put off

STEERING_LOST = 6.0  # [m] sd of a robot's place in the map beyond which it looks for known landmarks
STEERING_LANDMARK_REACHED = 4.0  # [m] from a landmark at which a lost robot has tried it: well within the reach
WALLS_LEG = 2.0  # [m] of the path ahead whose narrowness allows a robot to come nearer to walls
WALLS_DETOUR = 6.0  # [m] within which a robot plans its path round places where a wall was met lately


def offered(
    belief: LandmarkBelief, pose: Float[np.ndarray, "3"], cfg: ExploreConfig, towards: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Controls (m, 2) whose predicted pose stays in the field, and those poses (m, 3); among walls see below.

    Facing a border closer than the shortest step no control stays inside: then the slowest ones are offered, so that
    the robot can turn away. A robot that finds itself outside is offered the one control that leads back soonest.
    """
    if belief.floor is not None:
        return clear_controls(belief, belief.floor, pose, cfg, towards)
    controls = cfg.controls
    poses = move(pose, controls, cfg.submap.period)
    inside = np.all((poses[:, :2] >= belief.lower) & (poses[:, :2] <= belief.upper), axis=1)
    if not inside.any():
        back = np.clip(pose[:2], belief.lower, belief.upper)
        if np.array_equal(back, pose[:2]):
            inside = controls[:, 0] == min(cfg.commands.speeds)
        else:
            inside[np.argmin(_time_to(poses, 0.98 * back + 0.02 * 0.5 * (belief.lower + belief.upper)))] = True
    return controls[inside], poses[inside]


def clear_controls(
    belief: LandmarkBelief,
    floor: FloorPlan,
    pose: np.ndarray,
    cfg: ExploreConfig,
    towards: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Controls (m, 2), with the poses (m, 3) they lead to, that keep clear of walls and in the field.

    Clear: as far from walls, and from places where one was met lately, as is comfortable, or as the straight path
    `towards` a place is; a robot that is nearer comes no nearer. Where no control is, the margin has to do, or a third
    of it; where that is not kept either, the robot turns on the spot, to the side on which it can drive on that is
    nearest to its heading, or to the way `towards` a place.
    """
    obstacles = owned(np.vstack([floor.walls.segments, np.hstack([belief.contacts, belief.contacts])]))
    comfort = WALLS_COMFORT
    if towards is not None:
        step = towards - pose[:2]
        near = pose[:2] + step * min(1.0, WALLS_LEG / max(float(np.hypot(*step)), 1e-9))
        leg = distance_of_moves(pose[None, :2].copy(), near[None], obstacles)[0] - cfg.walls.robot_radius
        comfort = min(comfort, max(cfg.walls.margin, 0.8 * float(leg)))
    controls = cfg.controls
    poses = move(pose, controls, cfg.submap.period)
    for margin in (comfort, cfg.walls.margin, cfg.walls.margin / 3):
        clear = _clear(belief, pose, poses, obstacles, cfg.walls.robot_radius + margin)
        if clear.any():
            return controls[clear], poses[clear]
    turns = np.array([(0.0, w) for w in cfg.commands.turns if w != 0.0])
    rim = np.linspace(-np.pi, np.pi, 32, endpoint=False)
    around = np.column_stack([np.tile(pose[:2], (32, 1)), pose[2] + rim])
    slow = move(around, np.broadcast_to([min(cfg.commands.speeds), 0.0], (32, 2)), cfg.submap.period)
    ways = rim[_clear(belief, pose, slow, obstacles, cfg.walls.robot_radius + cfg.walls.margin / 3)]
    if len(ways):
        wish = 0.0 if towards is None else np.arctan2(*(towards - pose[:2])[::-1]) - pose[2]
        best = ways[np.argmin(np.abs(wrap_angle(ways - wish)) + 1e-6 * np.abs(ways))]
        turns = turns[[np.argmin(np.abs(wrap_angle(turns[:, 1] * cfg.submap.period - best)))]]
    return turns, move(pose, turns, cfg.submap.period)


def _clear(
    belief: LandmarkBelief, pose: np.ndarray, poses: np.ndarray, obstacles: np.ndarray, room: float
) -> np.ndarray:
    """Which straight moves from `pose` to `poses` (m, 3) keep `room` [m] from `obstacles`, or come no nearer."""
    here = np.broadcast_to(pose[:2], (len(poses), 2)).copy()
    along = distance_of_moves(here, poses[:, :2].copy(), obstacles)
    now = distance_of_moves(here[:1], here[:1], obstacles)[0]
    out = np.maximum(np.maximum(belief.lower - poses[:, :2], poses[:, :2] - belief.upper), 0.0).sum(axis=1)
    out_now = np.maximum(np.maximum(belief.lower - pose[:2], pose[:2] - belief.upper), 0.0).sum()
    return np.asarray(((out == 0.0) | (out < out_now)) & (along >= min(room, now) - 1e-9))


def new_cells(belief: LandmarkBelief, j: int, poses: Float[np.ndarray, "m 3"], cfg: ExploreConfig) -> np.ndarray:
    """How many cells (m,) robot j, as far as it knows, would be the first to see from each of `poses`."""
    ex, sector = belief.explored, Sector(cfg.submap.reach, cfg.submap.half_angle)
    known = ex.known_to(j)
    if belief.floor is None:
        return unexplored_cells(known, poses, sector, ex.raster)
    walls = belief.floor.walls.segments
    return unexplored_in_sight(known, poses, sector, ex.raster, walls)


def ahead(belief: LandmarkBelief, pose: Float[np.ndarray, "3"], goal: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Where (2,) to head for now on the way to `goal`: the goal itself in an open field, else round the walls."""
    if belief.floor is None:
        return goal
    near = belief.contacts[np.hypot(*(belief.contacts - pose[:2]).T) < WALLS_DETOUR]
    return belief.floor.waypoint(pose[:2], goal, near, cfg.walls.robot_radius + cfg.walls.margin)


def steer(belief: LandmarkBelief, pose: Float[np.ndarray, "3"], goal: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """The offered control (2,) that heads for `goal` soonest: turn towards it, fast when it lies ahead."""
    place = ahead(belief, pose, goal, cfg)
    controls, poses = offered(belief, pose, cfg, place)
    return np.asarray(controls[np.argmin(_time_to(poses, place))])


def _time_to(poses: Float[np.ndarray, "m 3"], goal: Float[np.ndarray, "2"]) -> np.ndarray:
    """Distance [m] from each pose to `goal`, with what a wrong heading counts as: no circling, no crawling."""
    d = goal - poses[:, :2]
    error = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - poses[:, 2]))
    return np.asarray(np.hypot(d[:, 0], d[:, 1]) + STEERING_HEADING_COST * error)


def is_lost(G: GlobalMap, submap: Submap) -> bool:
    """Whether a robot no longer knows where in the map it is: how unsure its place is, along the worst direction."""
    P = pose_in_map(G, submap)[1]
    return bool(np.linalg.eigvalsh(P[:2, :2])[-1] > STEERING_LOST**2)


def way_back(belief: LandmarkBelief, j: int, pose: Float[np.ndarray, "3"]) -> np.ndarray | None:
    """Where (2,) robot j finds itself again: the nearest mapped landmark not tried yet; None while it is not lost.

    A landmark reached without help counts as tried, since a lost robot is not where it thinks.
    """
    tried: dict[int, set[str]] = belief.memory.setdefault("tried", {})
    G = belief.global_map
    if not G.ids or not is_lost(G, belief.submaps[j]):
        tried.pop(j, None)
        return None
    seen = tried.setdefault(j, set())
    d = np.hypot(*(G.mean - pose[:2]).T)
    seen.update(G.ids[i] for i in np.flatnonzero(d < STEERING_LANDMARK_REACHED))
    left = [i for i in range(len(G.ids)) if G.ids[i] not in seen]
    if not left:
        seen.clear()
        left = list(range(len(G.ids)))
    return np.asarray(G.mean[left[int(np.argmin(d[left]))]])


def next_target(belief: LandmarkBelief, j: int, pose: Float[np.ndarray, "3"]) -> np.ndarray | None:
    """The unexplored cell (2,) robot j goes for next: the nearest, among walls one that was not put off lately."""
    ex = belief.explored
    left = ex.centres(np.argwhere(~ex.known_to(j)))
    if belief.floor is None:
        return nearest_unexplored(left, pose)
    off: dict[tuple[float, float], int] = belief.memory.setdefault("put_off", {})
    fresh = np.array([belief.step >= off.get((float(x), float(y)), 0) for x, y in left], dtype=bool)
    goal = nearest_unexplored(left[fresh] if fresh.any() else left, pose, belief.floor)
    belief.memory.setdefault("target_since", {})[j] = belief.step
    return goal


def given_up(belief: LandmarkBelief, j: int, target: np.ndarray) -> bool:
    """Whether robot j, among walls, has gone for `target` for so long that it puts it off for another."""
    if belief.floor is None or belief.step - belief.memory.get("target_since", {}).get(j, belief.step) < PUT_OFF_AFTER:
        return False
    off = belief.memory.setdefault("put_off", {})
    off[float(target[0]), float(target[1])] = belief.step + 4 * PUT_OFF_AFTER
    return True


def nearest_unexplored(
    unexplored_centres: np.ndarray, pose: Float[np.ndarray, "3"], floor: FloorPlan | None = None
) -> np.ndarray | None:
    """The unexplored cell centre (2,) nearest to the robot: it borders explored ground. None when all is seen.

    Among walls: the one whose nearest view is the shortest path off, None where no path leads to any.
    """
    if len(unexplored_centres) == 0:
        return None
    if floor is not None:
        at = floor.ground.cells(floor.view_of(unexplored_centres))
        far = floor.from_places(pose[None, :2])[0][at[:, 0], at[:, 1]]
        best = int(np.argmin(far + 1e-3 * np.hypot(*(unexplored_centres - pose[:2]).T)))
        return np.asarray(unexplored_centres[best]) if np.isfinite(far[best]) else None
    d = unexplored_centres - pose[:2]
    return np.asarray(unexplored_centres[np.argmin(np.einsum("ij,ij->i", d, d))])


OUT_OF_REACH = 1e6  # [m], where landmarks are put that nobody sees


def choose(belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig) -> Float[np.ndarray, "r 2"]:
    """The control of largest J for every live robot ([Yuan09] eq. 20 and 21), or its escape to a frontier."""
    out = np.zeros((len(belief.robots), 2))
    hulls = [_submap_points(belief, i, poses[i]) for i in range(len(belief.robots))]
    targets: dict[int, np.ndarray] = belief.memory.setdefault("targets", {})
    for j in np.flatnonzero(belief.alive):
        out[j] = _choose_one(belief, int(j), poses[j], hulls, targets, cfg)
    return out


def choose_area(
    belief: LandmarkBelief, poses: Float[np.ndarray, "r 3"], cfg: ExploreConfig
) -> Float[np.ndarray, "r 2"]:
    """The paper's planner without its accuracy term."""
    return choose(belief, poses, replace(cfg, objective=replace(cfg.objective, w_accuracy=0.0)))


def objective(
    belief: LandmarkBelief, j: int, pose: Float[np.ndarray, "3"], hulls: list[np.ndarray], cfg: ExploreConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offered controls (m, 2) of robot j, their J (m,) and the cells each would newly see (m,)."""
    controls, after = offered(belief, pose, cfg)
    sub, s = belief.submaps[j], cfg.submap
    gain = new_cells(belief, j, after, cfg)
    J = cfg.objective.w_area * gain * belief.explored.cell**2 / (0.5 * np.pi * cfg.submap.reach**2)
    if cfg.objective.w_accuracy:
        C = expected_uncertainty(
            np.asarray(sub.pose),
            _within_sight(belief, j, pose, cfg),
            np.asarray(sub.cov),
            controls,
            MotionAndSight(s.period, s.Q, s.R, Sector(s.reach, s.half_angle)),
        )
        least = C.min()
        J = J + cfg.objective.w_accuracy * (least / np.maximum(C, 1e-300) if least > 0 else np.ones_like(C))
    others = [i for i in np.flatnonzero(belief.alive) if i != j]
    if others and cfg.objective.w_apart:
        d = np.stack([distance_to_hull(hulls[i], after[:, :2]) for i in others])
        J = J + cfg.objective.w_apart * np.minimum(d / cfg.objective.apart_distance, 1.0).mean(axis=0)
    return controls, J, gain


def _choose_one(
    belief: LandmarkBelief,
    j: int,
    pose: np.ndarray,
    hulls: list[np.ndarray],
    targets: dict[int, np.ndarray],
    cfg: ExploreConfig,
) -> np.ndarray:
    ex = belief.explored
    known = None if cfg.objective.literal_escape else way_back(belief, j, pose)
    if known is not None:
        return steer(belief, pose, known, cfg)
    if j in targets:
        if ex.sees(j, targets[j]) or given_up(belief, j, targets[j]):
            del targets[j]
        else:
            return steer(belief, pose, targets[j], cfg)
    controls, J, gain = objective(belief, j, pose, hulls, cfg)
    if gain.max() <= cfg.objective.negligible_gain:
        sub = belief.submaps[j]
        sure = map_uncertainty(np.asarray(sub.cov)) / (len(sub.ids) + 1) <= cfg.objective.escape_uncertainty
        stalled = not cfg.objective.literal_escape and belief.stalled[j] >= cfg.objective.stall_steps
        goal = next_target(belief, j, pose) if sure or stalled else None
        if goal is not None:
            targets[j] = goal
            return steer(belief, pose, goal, cfg)
    return np.asarray(controls[np.argmax(J)])


def _within_sight(belief: LandmarkBelief, j: int, pose: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """Landmarks (n, 2) of robot j's submap; those that walls hide from where it is are put out of reach."""
    marks = belief.submaps[j].mean
    if belief.floor is None:
        return marks
    there = se2.act(belief.global_map.frames[j], marks)
    hidden = ~belief.floor.sees(pose[:2], there, 1.5 * cfg.submap.reach)
    return owned(np.where(hidden[:, None], OUT_OF_REACH, marks))


def _submap_points(belief: LandmarkBelief, i: int, pose: np.ndarray) -> np.ndarray:
    """Robot i's submap in the map, its landmarks and itself: hull corners counter-clockwise, or all points if flat."""
    points = np.vstack([se2.act(belief.global_map.frames[i], belief.submaps[i].mean), pose[:2]])
    if len(points) < 3:
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def distance_to_hull(hull: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Signed distance [m] to a convex polygon (corners counter-clockwise), a segment or a point; inside is negative."""
    a = hull
    b = np.roll(hull, -1, axis=0)
    ab = b - a
    ap = points[:, None, :] - a[None]
    length2 = np.maximum(np.einsum("kd,kd->k", ab, ab), 1e-12)
    u = np.clip(np.einsum("nkd,kd->nk", ap, ab) / length2, 0.0, 1.0)
    nearest = np.linalg.norm(ap - u[..., None] * ab, axis=-1).min(axis=1)
    if len(hull) < 3:
        return np.asarray(nearest)
    cross = ab[:, 0] * ap[..., 1] - ab[:, 1] * ap[..., 0]
    inside = np.all(cross >= 0, axis=1)
    return np.asarray(np.where(inside, -nearest, nearest))
