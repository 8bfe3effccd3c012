"""How far each robot may be off: blocks of the covariance, and the share of its largest mode."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..solve import Information
from .factors import width
from .gauge import Gauge
from .network import Network

WEAK_SHARE, WEAK_SPREAD = 0.8, 3.0  # share of the variance in one mode; spread in units of a sighting's own error
POWER_STEPS = 12


@dataclass(frozen=True, slots=True)
class Spread:
    """cov: (n, d, d), zero for anchors, NaN where not localisable; mode_share: None when a gauge is free."""

    cov: Float[np.ndarray, "n d d"]
    heading_var: Float[np.ndarray, " n"] | None
    mode_share: float | None
    weak: bool


def spread_of(
    net: Network,
    gauge: Gauge,
    A: Information,
    free: np.ndarray,
    localisable: Bool[np.ndarray, " n"],
    position: Float[np.ndarray, "n d"],
    gauge_basis: tuple[np.ndarray, np.ndarray],
) -> Spread:
    """Per-robot covariances from the information `A` over the entries `free`; exact sightings leave none."""
    dim = net.dim
    blocks = robot_blocks(A, free, len(net), width(net), *gauge_basis)
    exact = not np.any(net.sigma > 0)
    cov = blocks[:, :dim, :dim] * (0.0 if exact else 1.0)
    cov[~localisable] = np.nan
    cov[list(net.anchors)] = 0.0
    heading_var = None
    if not net.axis:
        heading_var = np.where(localisable, blocks[:, dim, dim] * (0.0 if exact else 1.0), np.nan)
    share = None if exact or gauge.name else _largest_mode(net, A, free, cov, localisable)
    weak = share is not None and share > WEAK_SHARE and _spread_ratio(net, cov, localisable, position) > WEAK_SPREAD
    return Spread(cov, heading_var, share, weak)


def robot_blocks(
    A: Information, free: np.ndarray, n: int, w: int, G: np.ndarray, C: np.ndarray
) -> Float[np.ndarray, "n w w"]:
    """Covariance blocks by robot with the conditions `C^T dx = 0` (Baarda's S-transformation), zero where fixed."""
    if not len(free):
        return np.zeros((n, w, w))
    at = np.full(n * w, -1)
    at[free] = np.arange(len(free))
    index = at.reshape(n, w)
    known = index >= 0
    blocks = A.blocks(np.where(known, index, np.maximum(index.max(axis=1, keepdims=True), 0)))
    blocks = blocks * known[:, :, None] * known[:, None, :]
    if G.shape[1]:
        B = np.zeros_like(C)
        B[free] = A.solve(C[free])
        M = C.T @ B
        K = np.linalg.solve((C.T @ G).T, G.T).T.reshape(n, w, -1)
        B = B.reshape(n, w, -1)
        blocks = blocks - K @ B.swapaxes(1, 2) - B @ K.swapaxes(1, 2) + K @ M @ K.swapaxes(1, 2)
    return np.asarray(0.5 * (blocks + blocks.swapaxes(1, 2)))


def _largest_mode(
    net: Network, A: Information, free: np.ndarray, cov: np.ndarray, localisable: np.ndarray
) -> float | None:
    """The share of all position variance in its largest mode, by power iteration."""
    chosen = localisable & ~net.is_anchor
    if not chosen.any():
        return None
    mask = np.zeros((len(net), width(net)), dtype=bool)
    mask[chosen, : net.dim] = True
    mine = mask.ravel()[free]
    x, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(len(free), 3)) * mine[:, None])
    top = 0.0
    for _ in range(POWER_STEPS):
        y = A.solve(x) * mine[:, None]
        top = float(np.linalg.eigvalsh(x.T @ y)[-1])
        x, _ = np.linalg.qr(y)
    return top / float(np.trace(cov[chosen], axis1=1, axis2=2).sum())


def _spread_ratio(net: Network, cov: np.ndarray, localisable: np.ndarray, position: np.ndarray) -> float:
    """Root mean square standard deviation of a robot, in units of one sighting's error at its usual distance."""
    chosen = localisable & ~net.is_anchor
    span = np.linalg.norm(position[net.target] - position[net.observer], axis=1)
    own = float(np.median(span) * np.sqrt(np.mean(net.sigma**2)))
    return float(np.sqrt(np.trace(cov[chosen], axis1=1, axis2=2).mean())) / own
