"""Pairs of landmark maps of very unequal quality: where weights earn their keep. Many worlds at once."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...core.config import config


@config
class UnequalConfig:
    """Two maps of n landmarks each, m in common; every landmark of each map has its own deviation, log-uniform."""

    n: int = 10
    m: int = 6
    arena: float = 1.5  # [m]
    smallest: float = 0.002  # [m]
    largest: float = 0.05  # [m]

    @property
    def total(self) -> int:
        return 2 * self.n - self.m


@dataclass(frozen=True, slots=True)
class UnequalMaps:
    """S worlds of two maps, the common landmarks first in each.

    landmarks: (S, N, 2) the truth in frame 1; frame: (S, 3) of map 2; index[k]: (n,) the landmarks of map k;
    mean: (S, 2, n, 2) in the maps' own frames; cov: (S, 2, 2n, 2n).
    """

    landmarks: Float[np.ndarray, "s t 2"]
    frame: Float[np.ndarray, "s 3"]
    index: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]
    mean: Float[np.ndarray, "s 2 n 2"]
    cov: Float[np.ndarray, "s 2 d d"]


def draw_unequal(cfg: UnequalConfig, count: int, rng: np.random.Generator) -> UnequalMaps:
    """`count` worlds whose maps err as their covariances say."""
    landmarks = rng.uniform(0.0, cfg.arena, (count, cfg.total, 2))
    frame = rng.uniform([-cfg.arena, -cfg.arena, -np.pi], [cfg.arena, cfg.arena, np.pi], (count, 3))
    index = (np.arange(cfg.n), np.r_[np.arange(cfg.m), np.arange(cfg.n, cfg.total)])
    local = np.stack([landmarks[:, index[0]], se2.act(se2.inverse(frame)[:, None], landmarks[:, index[1]])], axis=1)
    sigma = np.exp(rng.uniform(np.log(cfg.smallest), np.log(cfg.largest), (count, 2, cfg.n)))
    variance = np.repeat(sigma**2, 2, axis=-1)
    return UnequalMaps(
        landmarks=landmarks,
        frame=frame,
        index=index,
        mean=local + sigma[..., None] * rng.standard_normal(local.shape),
        cov=variance[..., None] * np.eye(2 * cfg.n),
    )
