"""Ranges, motions and priors as factors over nodes, a bias a pair of radios and a clock a robot; how errors last."""

from typing import NamedTuple

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


class RadioColumns(NamedTuple):
    """Where in x stand, of each range, the bias of its pair and how it grows over the log, and of both its robots by
    how much stamps of ranges are later than those of odometry, and how that grows.
    """

    bias: Int[np.ndarray, " k"]
    growth: Int[np.ndarray, " k"]
    lag_a: Int[np.ndarray, " k"]
    drift_a: Int[np.ndarray, " k"]
    lag_b: Int[np.ndarray, " k"]
    drift_b: Int[np.ndarray, " k"]

    def known(self, x: Float[np.ndarray, " n"], r: Ranges) -> tuple[Ranges, Float[np.ndarray, " k"]]:
        """Ranges where their ends were when they were measured, and their biases [m]."""
        lag_a, lag_b = x[self.lag_a] + x[self.drift_a] * r.s, x[self.lag_b] + x[self.drift_b] * r.s
        return r.late(lag_a, lag_b), x[self.bias] + x[self.growth] * r.s


def closing(r: Ranges, pose: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """[m/s] by which each distance grows as either end moves on."""
    unit = geometry(r, pose)[1]
    v_a, v_b = ((se2.rotation(pose[k, 2]) @ v[..., None])[..., 0] for k, v in ((r.a, r.rate_a), (r.b, r.rate_b)))
    return np.asarray((unit * v_a).sum(axis=1)), np.asarray(-(unit * v_b).sum(axis=1))


def range_factor(r: Ranges, radio: RadioColumns, sd: Float[np.ndarray, " k"], kernel: Kernel | None) -> Factor:
    """`|p_a - p_b| + bias - z` over both nodes, the pair's bias and both robots' clocks."""
    nodes = 3 * (1 + int(max(r.a.max(initial=0), r.b.max(initial=0))))
    at = np.concatenate([columns_of(r.a), columns_of(r.b), np.column_stack(radio)], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        then, bias = radio.known(x, r)
        return np.asarray((geometry(then, x[:nodes].reshape(-1, 3))[0] + bias - r.z)[:, None])

    def jacobian(x: np.ndarray) -> np.ndarray:
        then, pose = radio.known(x, r)[0], x[:nodes].reshape(-1, 3)
        _, unit, turn_a, turn_b = geometry(then, pose)
        v_a, v_b = closing(then, pose)
        rows = (unit, turn_a, -unit, turn_b, np.ones(len(unit)), r.s, -v_a, -v_a * r.s, -v_b, -v_b * r.s)
        return np.column_stack(rows)[:, None, :]

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
