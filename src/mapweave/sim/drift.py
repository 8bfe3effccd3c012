"""Odometry that drifts as wheels do: a scale that wanders, noise by the metre, a heading bias."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from ..core import se2
from ..core.config import config
from ..core.se2 import representable_heading

MOST_BIAS = np.radians(0.8)  # [rad/m]


@config
class DriftConfig:
    scale: float = 0.03  # standing deviation of the scale error, an Ornstein-Uhlenbeck process
    scale_length: float = 15.0  # [m] over which it is correlated
    translation: float = 0.005  # [m per sqrt(m)]
    rotation: float = np.radians(0.3)  # [rad per sqrt(m)]
    end_error: tuple[float, float] | None = (15.0, 20.0)  # [m]; the heading bias is chosen for it; None: no bias


def drifted(
    truth: Float[np.ndarray, "n 3"], cfg: DriftConfig, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """`T_odom_robot` (n, 3) along `truth`, from the origin, and the heading bias [rad/m] that was chosen.

    The bias is the smallest, left or right, with which the last pose errs by a draw from `end_error`; where none up to
    0.8 degrees a metre does, the one that comes nearest.
    """
    step = se2.log(se2.between(truth[:-1], truth[1:]))
    ds = np.abs(step[:, 0])
    n = len(ds)
    noise = rng.standard_normal((n, 3))
    shock = rng.standard_normal(n)
    scale = np.empty(n)
    now = cfg.scale * float(rng.standard_normal())
    for k in range(n):
        keep = np.exp(-ds[k] / cfg.scale_length)
        now = now * keep + cfg.scale * np.sqrt(max(0.0, 1 - keep * keep)) * shock[k]
        scale[k] = now
    root = np.sqrt(ds)
    u = step.copy()
    u[:, 0] += step[:, 0] * scale + cfg.translation * root * noise[:, 0]
    u[:, 1] += cfg.translation * root * noise[:, 1]
    u[:, 2] += cfg.rotation * root * noise[:, 2]
    bias = 0.0
    if cfg.end_error is not None:
        bias = _bias_for(u, ds, truth, float(rng.uniform(*cfg.end_error)))
        u[:, 2] += bias * ds
    poses = _integrated(u)
    poses[:, 2] = [representable_heading(float(theta)) for theta in poses[:, 2]]
    return poses, bias


def _bias_for(u: np.ndarray, ds: np.ndarray, truth: np.ndarray, wanted: float) -> float:
    end = se2.between(truth[0], truth[-1])[:2]

    def miss(bias: float) -> float:
        v = u.copy()
        v[:, 2] += bias * ds
        return float(np.hypot(*(_integrated(v)[-1, :2] - end))) - wanted

    tried = np.linspace(-MOST_BIAS, MOST_BIAS, 161)
    missed = np.array([miss(bias) for bias in tried])
    roots = np.flatnonzero(missed[:-1] * missed[1:] <= 0)
    if not len(roots):
        return float(tried[np.argmin(np.abs(missed))])
    k = roots[np.argmin(np.abs(tried[roots] + tried[roots + 1]))]
    return float(brentq(miss, tried[k], tried[k + 1], xtol=1e-9))


def _integrated(u: np.ndarray) -> np.ndarray:
    """Poses (n + 1, 3) from the origin through the twists u (n, 3)."""
    theta = np.concatenate([[0.0], np.cumsum(u[:, 2])])
    local = se2.exp(u)
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    dx = c * local[:, 0] - s * local[:, 1]
    dy = s * local[:, 0] + c * local[:, 1]
    return np.column_stack(
        [np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)]), se2.wrap_angle(theta)]
    )
