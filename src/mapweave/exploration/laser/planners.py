"""The planners for laser worlds by name: each shares out the frontiers in its own way, all drive alike."""

import numpy as np
from jaxtyping import Float

from .belief import LaserBelief
from .config import LaserExploreConfig
from .drive import drive
from .task_allocation import by_objective, by_tours, nearest_first


def coverage(belief: LaserBelief, poses: Float[np.ndarray, "r 3"], cfg: LaserExploreConfig) -> Float[np.ndarray, "r 2"]:
    """Balanced tours over all frontiers by the length of the way; every robot heads for the first of its tour."""
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
