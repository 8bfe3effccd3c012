"""EKF-SLAM inside one robot's local submap, which starts empty with `r = 0, P_rr = 0` and so stays independent."""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.names import unused
from ..core.records import owned
from ..core.se2 import wrap_angle
from ..kernels.landmarks import submap as kernels
from .association import Assignment, certain, jcbb, nearest_neighbour
from .landmark_map import Submap

NEW_GATE = 25.0  # D^2 from every landmark beyond which an observation starts a new one
SUBMAP_HIDDEN = 1e-6  # [1/m^2] new landmarks expected inside the gate of a known one
SUBMAP_LINEAR = 5.0  # deviations from the robot within which a landmark is too near for range and bearing


@config
class SubmapConfig:
    """Noise and gates of the submap filter."""

    period: float = 0.5  # [s] between two controls, T
    range_sd: float = 0.2  # [m] standard deviation of a range
    bearing_sd: float = 0.04  # [rad] standard deviation of a bearing
    motion_sd: tuple[float, float, float] = (0.015, 0.015, 0.0025)  # a step: [m], [m], [rad]
    reach: float = 15.0  # [m] of the camera
    half_angle: float = np.pi / 2  # [rad] its view to either side
    association: str = "jcbb"  # known | nn | jcbb
    gate: float = 13.82  # D^2 of a match, 0.999 of chi-square with 2 degrees of freedom
    sure: float = 0.95  # probability below which a match is not used

    @property
    def Q(self) -> np.ndarray:
        return _diagonal(self.motion_sd)

    @property
    def R(self) -> np.ndarray:
        return _diagonal((self.range_sd, self.bearing_sd))


@cache
def _diagonal(sd: tuple[float, ...]) -> np.ndarray:
    return owned(np.diag(np.square(sd)))


class Observations(NamedTuple):
    """One step's sightings: z (m, 2) = range [m], bearing [rad] CCW from the robot's x; ids where they are known."""

    z: Float[np.ndarray, "m 2"]
    ids: tuple[str, ...] | None


class SubmapInfo(NamedTuple):
    """What an update did: the landmark each observation went to or started, None when dropped; the new ones."""

    assignment: tuple[int | None, ...]
    new: tuple[int, ...]
    dropped: int


def empty(robot: str, frame: str) -> Submap:
    """A submap at its own origin, certain of its pose, with no landmark."""
    return Submap(robot, np.zeros(3), (), np.zeros((0, 2)), np.zeros((3, 3)), frame)


def move(pose: Float[np.ndarray, "... 3"], control: Float[np.ndarray, "... 2"], period: float) -> np.ndarray:
    """The pose after `control` = (v [m/s], w [rad/s]) for `period`: [Yuan09] eq. 3 with the experiment's model."""
    x, y, theta = np.moveaxis(np.asarray(pose, float), -1, 0)
    v, w = np.moveaxis(np.asarray(control, float), -1, 0)
    return np.stack(
        [x + v * period * np.cos(theta), y + v * period * np.sin(theta), wrap_angle(theta + w * period)], axis=-1
    )


def predicted_observation(pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Range and bearing of `points` from `pose`: [Yuan09] eq. 5 with the sign of the bearing put right."""
    d = points - pose[:2]
    return np.stack([np.hypot(d[:, 0], d[:, 1]), wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - pose[2])], axis=-1)


def in_view(z: Float[np.ndarray, "n 2"], cfg: SubmapConfig) -> np.ndarray:
    """(n,) whether the camera shows what lies at ranges and bearings z."""
    return np.asarray((z[:, 0] > 0) & (z[:, 0] <= cfg.reach) & (np.abs(z[:, 1]) <= cfg.half_angle))


def predict(m: Submap, control: Float[np.ndarray, "2"], cfg: SubmapConfig) -> Submap:
    """`m` after the control: [Yuan09] eq. 6-8."""
    v, w = float(control[0]), float(control[1])
    pose, P = kernels.predicted(m.pose, m.cov, v, w, cfg.period, cfg.Q)  # [Yuan09] eq. 3, 6-8
    return Submap(m.robot, owned(pose), m.ids, m.mean, owned(P), m.frame)


def update(m: Submap, seen: Observations, cfg: SubmapConfig, name: str = "n") -> tuple[Submap, SubmapInfo]:
    """`m` after all of a step's observations, associated together before any is used: [Yuan09] eq. 9-11.

    An observation matches below `gate`, unless another landmark explains it nearly as well, starts a landmark beyond
    `new_gate` from every landmark that has none in this step (never with known identities, where the id decides), and
    is dropped in between. New landmarks are called `name` and a number.
    """
    if len(seen.z) == 0:
        return m, SubmapInfo((), (), 0)
    assignment = _associate(m, seen, cfg)
    out = list(assignment.landmark)
    rows = [k for k, a in enumerate(out) if a is not None]
    fresh = [k for k, is_new in enumerate(assignment.new) if is_new]
    z = np.asarray(seen.z, float)
    if rows:
        m = _correct(m, np.array([out[k] for k in rows]), z[rows], cfg)
    n = len(m.ids)
    if fresh:
        m = _add(m, _labels(m, seen, fresh, cfg, name), z[fresh], cfg)
    for offset, k in enumerate(fresh):
        out[k] = n + offset
    return m, SubmapInfo(tuple(out), tuple(range(n, n + len(fresh))), out.count(None))


def _labels(m: Submap, seen: Observations, fresh: list[int], cfg: SubmapConfig, name: str) -> list[str]:
    """What the landmarks first seen in the observations `fresh` are called."""
    if seen.ids is not None and cfg.association == "known":
        return [seen.ids[k] for k in fresh]
    taken = set(m.ids)
    labels = []
    for _ in fresh:
        labels.append(unused(name, taken))
        taken.add(labels[-1])
    return labels


def _associate(m: Submap, seen: Observations, cfg: SubmapConfig) -> Assignment:
    if cfg.association == "known":
        if seen.ids is None:
            msg = "association='known' needs observations with ids"
            raise ValueError(msg)
        where = {name: i for i, name in enumerate(m.ids)}
        named = tuple(where.get(name) for name in seen.ids)
        return Assignment(named, tuple(a is None for a in named))
    zhat = predicted_observation(m.pose, m.mean)
    S = kernels.innovation(m.pose, m.mean, m.cov, np.arange(len(m.ids)))[1]
    rule = nearest_neighbour if cfg.association == "nn" else jcbb
    assignment = rule(seen.z, zhat, S, cfg.R, cfg.gate, NEW_GATE, wrap_columns=(1,))
    around = SUBMAP_HIDDEN * np.maximum(seen.z[:, 0], cfg.range_sd)
    return certain(assignment, seen.z, zhat, S, cfg.R, cfg.gate, NEW_GATE, (1,), around, cfg.sure)


def _correct(m: Submap, index: np.ndarray, z: np.ndarray, cfg: SubmapConfig) -> Submap:
    """One update with all sightings, [Yuan09] eq. 9-11; those too near to be linear come after, as places."""
    pose, mean, P = m.pose, m.mean, m.cov
    near = kernels.too_near(pose, mean, P, index, SUBMAP_LINEAR, cfg.R)
    if not near.all():
        pose, mean, P = kernels.corrected(pose, mean, P, index[~near], z[~near], cfg.R)
    for k in np.flatnonzero(near):
        pose, mean, P = kernels.placed(owned(pose), owned(mean), owned(P), index[k], z[k], cfg.R)
    return Submap(m.robot, owned(pose), m.ids, owned(mean), owned(P), m.frame)


def _add(m: Submap, labels: list[str], z: np.ndarray, cfg: SubmapConfig) -> Submap:
    """New landmarks by inverse observation, with their cross-covariances."""
    mean, P = kernels.grown(m.pose, m.mean, m.cov, z, cfg.R)
    return Submap(m.robot, m.pose, (*m.ids, *labels), owned(mean), owned(P), m.frame)
