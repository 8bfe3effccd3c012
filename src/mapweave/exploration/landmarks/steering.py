"""From a place to go to the control that goes there, among those that stay in the field."""

import numpy as np
from jaxtyping import Float

from ...core.records import owned
from ...core.se2 import wrap_angle
from ...fusion.handover import pose_in_map
from ...kernels.exploration.objective import unexplored_cells
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
