"""The edges of a pose graph as a term for the solver, in compiled loops: for graphs of thousands of poses."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..kernels.laser.pose_edges import edge_normal, edge_squares
from ..solve.problem import Kernel
from .pose_graph import PoseGraph


@dataclass(frozen=True, slots=True)
class PoseEdges:
    """The edges of `graph`, whose poses are not read, over x = [x0 y0 theta0 x1 ...]; each `weight` (m,) times.

    kernel: applied to each edge's squared whitened norm.
    """

    graph: PoseGraph
    weight: Float[np.ndarray, " m"]
    kernel: Kernel | None = None

    @property
    def columns(self) -> Int[np.ndarray, "m 6"]:
        """Which entries of x each edge touches."""
        i, j = 3 * self.graph.first[:, None], 3 * self.graph.second[:, None]
        return np.concatenate([i + np.arange(3), j + np.arange(3)], axis=1)

    @property
    def size(self) -> int:
        """Rows of residual in all."""
        return 3 * self.graph.edges

    def squares(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Squared whitened residual of each edge."""
        g = self.graph
        return np.asarray(self.weight * edge_squares(x.reshape(-1, 3), g.first, g.second, g.measured, g.information))

    def costs(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Robust cost of each edge."""
        s = self.squares(x)
        return s if self.kernel is None else np.asarray(self.kernel.cost(s))

    def normal(self, x: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "m 6 6"], Float[np.ndarray, "m 6"]]:
        """Information and gradient of each edge, robust weights in them."""
        g = self.graph
        weight = self.weight if self.kernel is None else self.weight * self.kernel.weight(self.squares(x))
        H, b = edge_normal(x.reshape(-1, 3), g.first, g.second, g.measured, g.information, weight)
        return H, b
