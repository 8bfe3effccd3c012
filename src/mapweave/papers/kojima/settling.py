"""How fast the covariance settles under the paper's own prior: where Theorem 2's 1/k has set in, and where not yet."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...fusion.relative_measurement import RelativeLayout, measurement
from . import limits
from .world import SEEN, KojimaConfig, LocalMaps

LAYOUT = RelativeLayout(2, 8)
EARLY = np.array([100.0, 300.0, 1000.0, 3000.0, 10_000.0])  # updates
LATE = 10.0 * EARLY
MERGES = 700.0  # updates of the experiment


@dataclass(frozen=True, slots=True)
class Settling:
    """Over S maps under the paper's prior, delta: of eq. 14; maps: which.

    early, late: (S,) spread of `k |P_k - P_inf|` over k in `EARLY` and `LATE`, as a share of its mean (0 where the
    error falls as 1/k); left: (S,) `|P_k - P_inf| / |P_inf|` after the experiment's 700 updates; printed: (S,) the
    same of the paper's closed form, eqs. 24-27, in place of P_k.
    """

    maps: str
    delta: float
    early: Float[np.ndarray, " s"]
    late: Float[np.ndarray, " s"]
    left: Float[np.ndarray, " s"]
    printed: Float[np.ndarray, " s"]


def prior_information(cfg: KojimaConfig) -> Float[np.ndarray, "n n"]:
    """The inverse of the paper's `P^G_800`."""
    return np.diag(1 / np.r_[np.full(3, cfg.prior_frame_variance), np.full(16, cfg.prior_landmark_variance)])


def settling(
    cfg: KojimaConfig, local: LocalMaps, x: Float[np.ndarray, "s n"], rng: np.random.Generator
) -> tuple[Settling, ...]:
    """The experiment's own maps of robot 2 at the states `x`, and `len(x)` drawn ones of some 2 to 7 cm."""
    drawn_points = rng.uniform(-1, 1, (len(x), 5, 2)) + np.array([3.0, 0.0])
    A = 0.01 * rng.normal(size=(len(x), 10, 10))
    drawn_cov = A @ np.swapaxes(A, -1, -2) + 1e-4 * np.eye(10)
    state = np.zeros_like(x)
    state[:, 3:13] = drawn_points.reshape(len(x), -1)
    state[:, 13:] = rng.uniform(-1, 1, (len(x), 6))
    index = np.arange(5)
    out = []
    for delta in (1.0, cfg.delta):
        each = replace(cfg, delta=delta)
        out.append(_settling("the experiment's", each, SEEN[1], local.mean[:, 1], local.cov[:, 1], x))
        out.append(_settling("less certain", each, index, drawn_points, drawn_cov, state))
    return tuple(out)


def _settling(
    name: str,
    cfg: KojimaConfig,
    index: np.ndarray,
    mean: Float[np.ndarray, "s 5 2"],
    cov: Float[np.ndarray, "s 10 10"],
    x: Float[np.ndarray, "s n"],
) -> Settling:
    measured = measurement(1, index, mean, cov, "paper", delta=cfg.delta)
    information = prior_information(cfg)
    spreads = np.empty((4, len(x)))
    for s, (H, R) in enumerate(zip(measured.dense_jacobian(LAYOUT, x), measured.R, strict=True)):
        P_inf = limits.limit(information, H)
        for row, ks in enumerate((EARLY, LATE)):
            scaled = np.array([k * np.linalg.norm(limits.after(information, H, R, k) - P_inf) for k in ks])
            spreads[row, s] = np.ptp(scaled) / scaled.mean()
        rest = limits.after(information, H, R, MERGES) - P_inf
        spreads[2, s] = np.linalg.norm(rest) / np.linalg.norm(P_inf)
        closed = limits.printed_limit(information[:3, :3], information[3:, 3:], H[:, :3], H[:, 3:])
        spreads[3, s] = np.linalg.norm(closed - P_inf) / np.linalg.norm(P_inf)
    return Settling(name, cfg.delta, *spreads)
