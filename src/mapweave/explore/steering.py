"""From a place to go to the control that goes there, among those that stay in the field."""

import numpy as np
from jaxtyping import Float

from ..core.se2 import wrap_angle
from ..estimate.submap_slam import move
from ..fuse.handover import pose_in_map
from .view import ExploreConfig, TeamView

LANDMARK_REACHED = 4.0  # [m]


def offered(view: TeamView, pose: Float[np.ndarray, "3"], cfg: ExploreConfig) -> tuple[np.ndarray, np.ndarray]:
    """Controls (m, 2) whose predicted pose stays in the field, and those poses (m, 3).

    Facing a border closer than the shortest step no control stays inside: then the slowest ones are offered, so that
    the robot can turn away. A robot that finds itself outside is offered the one control that leads back soonest.
    """
    controls = cfg.controls
    poses = move(pose, controls, cfg.submap.period)
    inside = np.all((poses[:, :2] >= view.lower) & (poses[:, :2] <= view.upper), axis=1)
    if not inside.any():
        back = np.clip(pose[:2], view.lower, view.upper)
        if np.array_equal(back, pose[:2]):
            inside = controls[:, 0] == min(cfg.speeds)
        else:
            inside[np.argmin(_time_to(poses, 0.98 * back + 0.02 * 0.5 * (view.lower + view.upper)))] = True
    return controls[inside], poses[inside]


def steer(view: TeamView, pose: Float[np.ndarray, "3"], goal: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
    """The offered control (2,) that heads for `goal` soonest: turn towards it, fast when it lies ahead."""
    controls, poses = offered(view, pose, cfg)
    return np.asarray(controls[np.argmin(_time_to(poses, goal))])


def _time_to(poses: Float[np.ndarray, "m 3"], goal: Float[np.ndarray, "2"]) -> np.ndarray:
    """Distance [m] from each pose to `goal`, a radian of heading counted as three metres: no circling, no crawling."""
    d = goal - poses[:, :2]
    error = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - poses[:, 2]))
    return np.asarray(np.hypot(d[:, 0], d[:, 1]) + 3.0 * error)


def way_back(view: TeamView, j: int, pose: Float[np.ndarray, "3"], cfg: ExploreConfig) -> np.ndarray | None:
    """Where (2,) robot j finds itself again: the nearest mapped landmark not tried yet; None while it is not lost.

    Lost: its place in the map has a standard deviation beyond `cfg.lost`. A landmark reached without help counts as
    tried, since a lost robot is not where it thinks.
    """
    tried: dict[int, set[str]] = view.memory.setdefault("tried", {})
    G = view.global_map
    _, P = pose_in_map(G, view.submaps[j])
    if not G.ids or np.linalg.eigvalsh(P[:2, :2])[-1] <= cfg.lost**2:
        tried.pop(j, None)
        return None
    seen = tried.setdefault(j, set())
    d = np.hypot(*(G.mean - pose[:2]).T)
    seen.update(G.ids[i] for i in np.flatnonzero(d < LANDMARK_REACHED))
    left = [i for i in range(len(G.ids)) if G.ids[i] not in seen]
    if not left:
        seen.clear()
        left = list(range(len(G.ids)))
    return np.asarray(G.mean[left[int(np.argmin(d[left]))]])


def nearest_unexplored(unexplored_centres: np.ndarray, pose: Float[np.ndarray, "3"]) -> np.ndarray | None:
    """The unexplored cell centre (2,) nearest to the robot: it borders explored ground. None when all is seen."""
    if len(unexplored_centres) == 0:
        return None
    d = unexplored_centres - pose[:2]
    return np.asarray(unexplored_centres[np.argmin(np.einsum("ij,ij->i", d, d))])
