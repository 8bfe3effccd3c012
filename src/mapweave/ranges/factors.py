"""Ranges, motions and priors as factors over nodes [x, y, theta] and a bias [m] a pair of radios; how errors last."""

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..solve import Factor, Kernel
from .network import Motions, Priors, Ranges

PRUNED = 3  # times that noise is told from those that are not far
LONGEST = 50  # ranges of a pair, or fixes, over which an error may last


def columns_of(node: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
    return np.asarray(3 * node[:, None] + np.arange(3))


def geometry(
    r: Ranges, pose: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 2"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Distances [m], unit vectors from b's antenna to a's, and how the distances grow with either heading [m/rad]."""
    R_a, R_b = se2.rotation(pose[r.a, 2]), se2.rotation(pose[r.b, 2])
    arm_a, arm_b = (R_a @ r.lever_a[..., None])[..., 0], (R_b @ r.lever_b[..., None])[..., 0]
    d = pose[r.a, :2] + arm_a - pose[r.b, :2] - arm_b
    distance = np.hypot(d[:, 0], d[:, 1])
    unit = d / np.maximum(distance, 1e-9)[:, None]
    return distance, unit, _across(unit, arm_a), -_across(unit, arm_b)


def _across(unit: np.ndarray, arm: np.ndarray) -> np.ndarray:
    return np.asarray(unit[:, 1] * arm[:, 0] - unit[:, 0] * arm[:, 1])


def range_factor(r: Ranges, bias: Int[np.ndarray, " k"], sd: Float[np.ndarray, " k"], kernel: Kernel | None) -> Factor:
    """`|p_a - p_b| + bias - z` over both nodes and the pair's bias, which stands at `bias` of x."""
    nodes = 3 * (1 + int(max(r.a.max(initial=0), r.b.max(initial=0))))
    at = np.concatenate([columns_of(r.a), columns_of(r.b), bias[:, None]], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        distance = geometry(r, x[:nodes].reshape(-1, 3))[0]
        return np.asarray((distance + x[at[:, 6]] - r.z)[:, None])

    def jacobian(x: np.ndarray) -> np.ndarray:
        _, unit, turn_a, turn_b = geometry(r, x[:nodes].reshape(-1, 3))
        rows = (unit, turn_a[:, None], -unit, turn_b[:, None], np.ones((len(unit), 1)))
        return np.concatenate(rows, axis=1)[:, None, :]

    return Factor(at, residual, jacobian, 1, 1.0 / sd[:, None], kernel, "ranges")


def motion_factor(m: Motions) -> Factor:
    """`z^-1 (x_first^-1 x_second)`, whitened by the motions' covariances."""
    W = np.linalg.cholesky(np.linalg.inv(m.cov)).swapaxes(1, 2)
    at = np.concatenate([columns_of(m.first), columns_of(m.second)], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(se2.between(m.z, se2.between(x[at[:, :3]], x[at[:, 3:]])))

    def jacobian(x: np.ndarray) -> np.ndarray:
        A, B = se2.between_jacobians(x[at[:, :3]], x[at[:, 3:]])
        R = se2.turn(-m.z[:, 2])
        return np.concatenate([R @ A, R @ B], axis=2)

    return Factor(at, residual, jacobian, 3, W, None, "motions")


def prior_factor(p: Priors) -> Factor:
    """`z^-1 x`, whitened."""
    W = np.linalg.cholesky(np.linalg.inv(p.cov)).swapaxes(1, 2)
    at = columns_of(p.node)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(se2.between(p.z, x[at]))

    def jacobian(x: np.ndarray) -> np.ndarray:
        return se2.between_jacobians(p.z, x[at])[1]

    return Factor(at, residual, jacobian, 3, W, None, "priors")


def number_factor(at: Int[np.ndarray, " k"], mean: Float[np.ndarray, " k"], sd: float, name: str) -> Factor:
    """Single variables near `mean`."""
    unit, white = np.ones((len(at), 1, 1)), np.full((len(at), 1), 1.0 / sd)
    return Factor(at[:, None], lambda x: (x[at] - mean)[:, None], lambda _: unit, 1, white, None, name)


def common_factor(at: Int[np.ndarray, " k"], common: int, sd: float) -> Factor:
    """The biases at `at` near what they have in common, which stands at `common` of x."""
    columns = np.column_stack([at, np.full(len(at), common)])
    unit, white = np.tile([[1.0, -1.0]], (len(at), 1, 1)), np.full((len(at), 1), 1.0 / sd)
    return Factor(columns, lambda x: (x[at] - x[common])[:, None], lambda _: unit, 1, white, None, "biases")


def lasting(e: Float[np.ndarray, " n"]) -> float:
    """For how many of n errors in order of time one lasts: one more than twice the sum of correlations, 1 or more."""
    if len(e) < 2 * LONGEST:
        return 1.0
    e = e - e.mean()
    power = float(e @ e)
    total = 1.0
    for lag in range(1, LONGEST):
        rho = float(e[lag:] @ e[:-lag]) / power
        if rho < 0.05:
            break
        total += 2.0 * rho
    return total
