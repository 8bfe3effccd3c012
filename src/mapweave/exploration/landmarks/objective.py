"""The paper's planner: each robot's best control under accuracy, new area, and distance to the others' submaps."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from ...core import se2
from ...core.records import owned
from ...kernels.exploration.objective import MotionAndSight, expected_uncertainty, map_uncertainty
from ...kernels.walls.segments import Sector
from .belief import LandmarkBelief
from .config import ExploreConfig
from .steering import given_up, new_cells, next_target, offered, steer, way_back

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
