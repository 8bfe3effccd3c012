"""The experiment of Hamatani, Nakamura and Naruse: five robots in the plane, filters run over repeated sightings."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ...core.attitude import matrices
from ...core.se2 import wrap_angle
from ...core.workers import Progress, no_progress
from ...io.kept import part
from ...sim.swarm import Layout, Swarm, SwarmScene, simulate_swarm
from ...swarm.bearing import angle
from ...swarm.config import SwarmConfig
from ...swarm.filtered import Form, filter_start, update
from ...swarm.locate import locate
from ...swarm.network import BearingNetwork
from ...swarm.result import SwarmStatus

H = 5.0 * np.sqrt(3.0)
LAYOUT = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [5.0, H], [15.0, H]])  # [m]
TRIANGLES = ((0, 1, 3), (1, 4, 3), (1, 2, 4))  # the three with sides of 10
SIDES = tuple(sorted({tuple(sorted(p)) for a, b, c in TRIANGLES for p in ((a, b), (b, c), (a, c))}))
IDS = ("1", "2", "3", "4", "5")
PRIOR_SIGMA = 10.0  # [m]: P0 = 100 I
UPDATES = 200
VARIANCES = (0.0, 0.01, 25.0)  # of the first positions [m^2] and of the bearings [deg^2]
FirstEstimate = Literal["guess", "linear"]


@dataclass(frozen=True, slots=True)
class TableCell:
    """One cell: variance of the guess [m^2], of a bearing [deg^2], whether robots 1 and 2 are known, the filter."""

    guess: float
    bearing: float
    known: bool
    form: Form = "ekf"
    first: FirstEstimate = "guess"


@dataclass(frozen=True, slots=True)
class Cell:
    """Errors of one case over all trials: of a triangle's side [m] and of its angle [deg], each trial's mean."""

    case: TableCell
    side: Float[np.ndarray, " t"]
    angle: Float[np.ndarray, " t"]


def sightings(variance: float, known: bool, rng: np.random.Generator) -> BearingNetwork:  # noqa: FBT001
    """One set: each pair of robots sighted once, from the lower number, with fresh noise of `variance` [deg^2]."""
    i, j = np.triu_indices(len(LAYOUT), 1)
    sigma = np.radians(np.sqrt(variance))
    z = np.asarray(wrap_angle(angle(LAYOUT[i], LAYOUT[j]) + sigma * rng.normal(size=len(i))))
    anchors = {k: LAYOUT[k] for k in (0, 1)} if known else {}
    return BearingNetwork(IDS, 2, i, j, z, np.full(len(i), sigma), anchors)


def guess(variance: float, rng: np.random.Generator) -> Float[np.ndarray, "5 2"]:
    """The true positions with noise of `variance` [m^2] on each coordinate."""
    return np.asarray(LAYOUT + np.sqrt(variance) * rng.normal(size=LAYOUT.shape))


def run_filter(
    case: TableCell, rng: np.random.Generator, updates: int = UPDATES
) -> tuple[Float[np.ndarray, "5 2"], Float[np.ndarray, "k 5 2"]]:
    """The first estimate, and the positions after each of `updates` sets of sightings."""
    first = guess(case.guess, rng)
    if case.first == "linear":  # the shape the first sightings give, as large as the guess and where it is
        shape = locate(sightings(case.bearing, case.known, rng), SwarmConfig(covariance=False)).position
        if not case.known:
            scale2 = np.square(first - first.mean(axis=0)).sum() / np.square(shape - shape.mean(axis=0)).sum()
            shape = first.mean(axis=0) + np.sqrt(scale2) * (shape - shape.mean(axis=0))
        first = shape
    state = filter_start(sightings(case.bearing, case.known, rng), first, PRIOR_SIGMA)
    path = np.empty((updates, *LAYOUT.shape))
    for k in range(updates):
        state = update(state, sightings(case.bearing, case.known, rng), case.form)
        path[k] = state.x
    return state.first, path


def measure(case: TableCell, trials: int, seed: int) -> Cell:
    """The mean errors of each trial after the last update."""
    side, corner = np.empty(trials), np.empty(trials)
    for trial in range(trials):
        key = [seed, trial, int(case.known), round(100 * case.guess), round(100 * case.bearing)]
        _, path = run_filter(case, np.random.default_rng(key))
        side[trial], corner[trial] = side_error(path[-1]), angle_error(path[-1])
    return Cell(case, side, corner)


def side_error(x: Float[np.ndarray, "5 2"]) -> float:
    """Mean error [m] of the seven sides of the three triangles."""
    return float(np.mean([abs(np.linalg.norm(x[i] - x[j]) - np.linalg.norm(LAYOUT[i] - LAYOUT[j])) for i, j in SIDES]))


def angle_error(x: Float[np.ndarray, "5 2"]) -> float:
    """Mean error [deg] of the nine interior angles of the three triangles."""
    errors = []
    for a, b, c in TRIANGLES:
        for top, left, right in ((a, b, c), (b, c, a), (c, a, b)):
            errors.append(abs(_corner(x, top, left, right) - _corner(LAYOUT, top, left, right)))
    return float(np.degrees(np.mean(errors)))


def _corner(x: np.ndarray, top: int, left: int, right: int) -> float:
    u, v = x[left] - x[top], x[right] - x[top]
    return float(abs(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v)))


@dataclass(frozen=True, slots=True)
class BeyondCase:
    """Robots, who see their eight nearest, in one layout; degrees: noise of a sighting.

    Known are the corners of the field, of five robots two of them as in the paper. axis: whether there is a common one;
    wrong: share of sightings that point anywhere, located by `robust`.
    """

    robots: int
    dim: Literal[2, 3]
    layout: Layout
    degrees: float
    axis: bool = True
    wrong: float = 0.0

    @property
    def place(self) -> str:
        """Where they are, and what of it is harder than in the paper."""
        words = ["the plane" if self.dim == 2 else "space"]
        words += ["no common axes"] * (not self.axis) + [f"{100 * self.wrong:.0f} % wrong"] * (self.wrong > 0.0)
        return ", ".join(words)


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
    BeyondCase(64, 3, "random", 0.5, axis=False),
    BeyondCase(64, 3, "grid", 0.5, axis=False, wrong=0.1),
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
    """The batch estimator, `robust` where sightings are wrong, without any guess, on `draws` swarms a case."""
    out = []
    for at, case in enumerate(cases):
        on_progress("beyond the paper", at, len(cases))
        out.append(part(_tried, case, draws, seed))
    return tuple(out)


def _tried(case: BeyondCase, draws: int, seed: int) -> Beyond:
    scene = SwarmScene(
        robots=case.robots, dim=case.dim, layout=case.layout, sigma=float(np.radians(case.degrees)),
        axis=case.axis, outliers=case.wrong,
    )  # fmt: skip
    scores = np.empty((5, draws))
    failed = 0
    for draw in range(draws):
        rng = np.random.default_rng([seed, 6, draw, case.robots, case.dim, round(100 * case.degrees)])
        swarm = simulate_swarm(scene, rng)
        truth = swarm.position[0]
        net = network(swarm)
        located = locate(net, SwarmConfig(method="robust" if case.wrong else "batch"))
        at_truth = locate(net.select(right(net, swarm)), SwarmConfig(max_iterations=0), truth)
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


def right(net: BearingNetwork, swarm: Swarm) -> Bool[np.ndarray, " m"]:
    """(m,) False for sightings that miss the truth by more than six standard deviations."""
    d = swarm.position[0][net.target] - swarm.position[0][net.observer]
    seen = net.direction
    if not net.axis:
        seen = np.einsum("mij,mj->mi", matrices(swarm.heading[0])[net.observer], seen)
    return np.asarray(np.einsum("mk,mk->m", d, seen) > np.cos(6.0 * net.sigma) * np.linalg.norm(d, axis=1))


def network(swarm: Swarm) -> BearingNetwork:
    """A standing swarm's sightings, its corners known; of five robots two of them."""
    table = swarm.table
    z = table.bearing() if table.dim == 2 else table.direction
    anchors = {k: swarm.position[0][k] for k in swarm.corners[: 2 if len(table.ids) == 5 else None]}
    return BearingNetwork(table.ids, table.dim, table.observer, table.target, z, table.sigma, anchors, axis=table.axis)
