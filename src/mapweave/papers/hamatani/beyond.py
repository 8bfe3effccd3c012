"""What the paper leaves to the future: robots anywhere, many of them, and space."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core.workers import Progress, no_progress
from ...io.kept import part
from ...sim.swarm import Layout, Swarm, SwarmScene, simulate_swarm
from ...swarm.config import SwarmConfig
from ...swarm.locate import locate
from ...swarm.network import BearingNetwork
from ...swarm.result import SwarmStatus


@dataclass(frozen=True, slots=True)
class BeyondCase:
    """Robots, who see their eight nearest, in one layout; degrees: noise of a sighting.

    Known are the corners of the field, of five robots two of them as in the paper.
    """

    robots: int
    dim: Literal[2, 3]
    layout: Layout
    degrees: float


CASES = (
    BeyondCase(5, 2, "random", 0.1),
    BeyondCase(5, 2, "random", 5.0),
    BeyondCase(100, 2, "random", 1.0),
    BeyondCase(100, 2, "clusters", 1.0),
    BeyondCase(400, 2, "random", 1.0),
    BeyondCase(64, 3, "random", 0.5),
    BeyondCase(64, 3, "random", 2.0),
    BeyondCase(64, 3, "random", 5.0),
    BeyondCase(64, 3, "clusters", 2.0),
    BeyondCase(216, 3, "grid", 2.0),
)


@dataclass(frozen=True, slots=True)
class Beyond:
    """One case over T draws of places and noise; each (T,).

    rmse, bound: [m] of the free robots that can be located, the bound at the truth; nees: per degree of freedom;
    left: robots that cannot be located; reliable: what the estimate says of itself; failed: runs that did not converge.
    """

    case: BeyondCase
    rmse: Float[np.ndarray, " t"]
    bound: Float[np.ndarray, " t"]
    nees: Float[np.ndarray, " t"]
    left: Float[np.ndarray, " t"]
    reliable: Bool[np.ndarray, " t"]
    failed: int

    @property
    def over_bound(self) -> float:
        """Root mean square error of all draws over the root mean square bound."""
        return float(np.sqrt(np.mean(self.rmse**2) / np.mean(self.bound**2)))

    @property
    def worst_trusted(self) -> float:
        """Greatest NEES per degree of freedom of the draws whose estimate calls itself reliable; nan without any."""
        return float(self.nees[self.reliable].max()) if self.reliable.any() else float("nan")


def beyond(
    cases: tuple[BeyondCase, ...], draws: int, seed: int, on_progress: Progress = no_progress
) -> tuple[Beyond, ...]:
    """The batch estimator, without any guess, on `draws` swarms a case."""
    out = []
    for at, case in enumerate(cases):
        on_progress("beyond the paper", at, len(cases))
        out.append(part(_tried, case, draws, seed))
    return tuple(out)


def _tried(case: BeyondCase, draws: int, seed: int) -> Beyond:
    scene = SwarmScene(robots=case.robots, dim=case.dim, layout=case.layout, sigma=float(np.radians(case.degrees)))
    scores = np.empty((5, draws))
    failed = 0
    for draw in range(draws):
        rng = np.random.default_rng([seed, 6, draw, case.robots, case.dim, round(100 * case.degrees)])
        swarm = simulate_swarm(scene, rng)
        truth = swarm.position[0]
        net = network(swarm)
        located = locate(net)
        at_truth = locate(net, replace(SwarmConfig(), max_iterations=0), truth)
        scored = located.localisable & ~located.anchor
        off = (located.position - truth)[scored]
        value, dof = located.nees(truth)
        scores[:, draw] = (
            np.sqrt(np.mean(np.sum(off**2, axis=1))),
            np.sqrt(np.trace(np.asarray(at_truth.cov)[scored], axis1=1, axis2=2).mean()),
            value / dof,
            np.sum(~located.localisable),
            located.reliable,
        )
        failed += located.status is not SwarmStatus.CONVERGED
    rmse, bound, nees, left, reliable = scores
    return Beyond(case, rmse, bound, nees, left, reliable.astype(bool), failed)


def network(swarm: Swarm) -> BearingNetwork:
    """A standing swarm's sightings, its corners known; of five robots two of them."""
    table = swarm.table
    z = table.bearing() if table.dim == 2 else table.direction
    anchors = {k: swarm.position[0][k] for k in swarm.corners[: 2 if len(table.ids) == 5 else None]}
    return BearingNetwork(table.ids, table.dim, table.observer, table.target, z, table.sigma, anchors)
