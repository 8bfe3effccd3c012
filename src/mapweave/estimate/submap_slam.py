"""EKF-SLAM inside one robot's local submap, which starts empty with `r = 0, P_rr = 0` and so stays independent."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.gaussian import symmetrise
from ..core.se2 import wrap_angle
from ..maps.submap import Submap
from ..match.association import Assignment, jcbb, nearest_neighbour


@config
class SubmapConfig:
    """Noise and gates of the submap filter."""

    period: float = 0.5  # [s], T
    range_sd: float = 0.2  # [m]
    bearing_sd: float = 0.04  # [rad]
    motion_sd: tuple[float, float, float] = (0.015, 0.015, 0.0025)  # a step: [m], [m], [rad]
    reach: float = 15.0  # [m]
    half_angle: float = np.pi / 2  # [rad]
    association: str = "jcbb"  # known | nn | jcbb
    gate: float = 9.21  # D^2 of a match, 0.99 of chi-square with 2 degrees of freedom
    new_gate: float = 25.0  # D^2 from every landmark beyond which an observation starts a new one

    @property
    def Q(self) -> np.ndarray:
        return np.diag(np.square(self.motion_sd))

    @property
    def R(self) -> np.ndarray:
        return np.diag(np.square((self.range_sd, self.bearing_sd)))


class Observations(NamedTuple):
    """One step's sightings: z (m, 2) = range [m], bearing [rad] CCW from the robot's x; ids where they are known."""

    z: Float[np.ndarray, "m 2"]
    ids: tuple[str, ...] | None


class SubmapInfo(NamedTuple):
    """What an update did: landmark index each observation went to, -1 - k for the k-th new one, None when dropped."""

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


def move_jacobian(pose: Float[np.ndarray, "3"], control: Float[np.ndarray, "2"], period: float) -> np.ndarray:
    """Derivative of `move` by the pose."""
    d = control[0] * period
    return np.array([[1.0, 0.0, -d * np.sin(pose[2])], [0.0, 1.0, d * np.cos(pose[2])], [0.0, 0.0, 1.0]])


def sight(pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Range and bearing of `points` from `pose`: [Yuan09] eq. 5 with the sign of the bearing put right."""
    d = points - pose[:2]
    return np.stack([np.hypot(d[:, 0], d[:, 1]), wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - pose[2])], axis=-1)


def sight_jacobians(
    pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 2"]]:
    """Derivatives of `sight` by the pose and by the points."""
    d = points - pose[:2]
    r = np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)
    q = r * r
    Hl = np.stack([np.stack([d[:, 0] / r, d[:, 1] / r], -1), np.stack([-d[:, 1] / q, d[:, 0] / q], -1)], axis=1)
    Hp = np.concatenate([-Hl, np.zeros((len(d), 2, 1))], axis=2)
    Hp[:, 1, 2] = -1.0
    return Hp, Hl


def in_view(z: Float[np.ndarray, "n 2"], cfg: SubmapConfig) -> np.ndarray:
    return np.asarray((z[:, 0] > 0) & (z[:, 0] <= cfg.reach) & (np.abs(z[:, 1]) <= cfg.half_angle))


def predict(m: Submap, control: Float[np.ndarray, "2"], cfg: SubmapConfig) -> Submap:
    """`m` after the control: [Yuan09] eq. 6-8."""
    F = move_jacobian(m.pose, control, cfg.period)
    P = m.cov.copy()
    P[:3] = F @ P[:3]
    P[:, :3] = P[:, :3] @ F.T
    P[:3, :3] += cfg.Q
    return replace(m, pose=move(m.pose, control, cfg.period), cov=symmetrise(P))


def update(m: Submap, seen: Observations, cfg: SubmapConfig, name: str = "n") -> tuple[Submap, SubmapInfo]:
    """`m` after all of a step's observations, associated together before any is used: [Yuan09] eq. 9-11.

    An observation matches below `gate`, starts a landmark beyond `new_gate` from every landmark (never with known
    identities, where the id decides), and is dropped in between. New landmarks are called `name` and a number.
    """
    if len(seen.z) == 0:
        return m, SubmapInfo((), (), 0)
    assignment = _associate(m, seen, cfg)
    used = [(k, a) for k, a in enumerate(assignment.landmark) if a is not None]
    if used:
        rows = np.array([k for k, _ in used])
        index = np.array([a for _, a in used])
        m = _correct(m, index, seen.z[rows], cfg)
    fresh = [k for k, is_new in enumerate(assignment.new) if is_new]
    taken = set(m.ids)
    labels: list[str] = []
    for k in fresh:
        label = seen.ids[k] if seen.ids is not None and cfg.association == "known" else _unused(name, taken)
        taken.add(label)
        labels.append(label)
    n = len(m.ids)
    if fresh:
        m = _add(m, labels, seen.z[np.array(fresh)], cfg)
    out: list[int | None] = list(assignment.landmark)
    for offset, k in enumerate(fresh):
        out[k] = n + offset
    dropped = sum(1 for a in out if a is None)
    return m, SubmapInfo(tuple(out), tuple(range(n, n + len(fresh))), dropped)


def _associate(m: Submap, seen: Observations, cfg: SubmapConfig) -> Assignment:
    if cfg.association == "known":
        if seen.ids is None:
            msg = "association='known' needs observations with ids"
            raise ValueError(msg)
        where = {name: i for i, name in enumerate(m.ids)}
        found = tuple(where.get(name) for name in seen.ids)
        return Assignment(found, tuple(a is None for a in found))
    zhat = sight(m.pose, m.mean)
    S = _innovation_cov(m)
    rule = nearest_neighbour if cfg.association == "nn" else jcbb
    return rule(seen.z, zhat, S, cfg.R, cfg.gate, cfg.new_gate, wrap_columns=(1,))


def _stacked(m: Submap, index: np.ndarray) -> np.ndarray:
    Hp, Hl = sight_jacobians(m.pose, m.mean[index])
    H = np.zeros((2 * len(index), len(m.cov)))
    for k, j in enumerate(index):
        H[2 * k : 2 * k + 2, :3] = Hp[k]
        H[2 * k : 2 * k + 2, 3 + 2 * j : 5 + 2 * j] = Hl[k]
    return H


def _innovation_cov(m: Submap) -> np.ndarray:
    H = _stacked(m, np.arange(len(m.ids)))
    return np.asarray(H @ m.cov @ H.T)


def _correct(m: Submap, index: np.ndarray, z: np.ndarray, cfg: SubmapConfig) -> Submap:
    H = _stacked(m, index)
    R = np.kron(np.eye(len(index)), cfg.R)
    PH = m.cov @ H.T
    S = symmetrise(H @ PH + R)
    K = np.linalg.solve(S, PH.T).T
    e = z - sight(m.pose, m.mean[index])
    e[:, 1] = wrap_angle(e[:, 1])
    dx = K @ e.ravel()
    A = np.eye(len(m.cov)) - K @ H
    P = symmetrise(A @ m.cov @ A.T + K @ R @ K.T)
    pose = m.pose + dx[:3]
    pose[2] = wrap_angle(pose[2])
    return replace(m, pose=pose, mean=m.mean + dx[3:].reshape(-1, 2), cov=P)


def _add(m: Submap, labels: list[str], z: np.ndarray, cfg: SubmapConfig) -> Submap:
    """New landmarks by inverse observation, with their cross-covariances."""
    n, k = len(m.cov), len(labels)
    angle = m.pose[2] + z[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    points = m.pose[:2] + z[:, :1] * np.stack([c, s], axis=-1)
    J = np.zeros((n + 2 * k, n))
    J[:n, :n] = np.eye(n)
    N = np.zeros((n + 2 * k, n + 2 * k))
    for i in range(k):
        rows = slice(n + 2 * i, n + 2 * i + 2)
        J[rows, :2] = np.eye(2)
        J[rows, 2] = (-z[i, 0] * s[i], z[i, 0] * c[i])
        G = np.array([[c[i], -z[i, 0] * s[i]], [s[i], z[i, 0] * c[i]]])
        N[rows, rows] = G @ cfg.R @ G.T
    P = symmetrise(J @ m.cov @ J.T + N)
    return replace(m, ids=(*m.ids, *labels), mean=np.vstack([m.mean, points]), cov=P)


def _unused(name: str, taken: set[str]) -> str:
    k = len(taken)
    while f"{name}{k}" in taken:
        k += 1
    return f"{name}{k}"
