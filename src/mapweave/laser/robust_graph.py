"""Any pose graph solved: gauge, priors, edges that contradict the rest dropped and told, covariances.

The residual of an edge is `z^-1 (x_i^-1 x_j)`, taken as x, y and theta: the measured pose's own frame, as g2o has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.errors import DataError
from ..core.gaussian import chi2_quantile
from ..core.records import frozen
from ..solve import Cauchy, Factor, Pattern, Problem, Solution, SolveConfig, SolveStatus, Term, minimise, wrapping
from ..solve.information import BlockCholesky
from ..solve.problem import Kernel
from .pose_graph import PoseEdges, PoseGraph

CONTRADICTION = 16.27  # squared sd (3 degrees of freedom, 0.1 %) beyond which an edge contradicts
MOST_ROUNDS = 80  # of a graduated kernel
EDGE_CHANCE = 1e-3  # that one edge of a graph without false ones lies so far from the others
ROBUST_SOLVE = SolveConfig(max_iterations=100, step_tolerance=1e-7, cost_tolerance=1e-9)  # of every round

ROBUST_GRAPH_KERNEL = 2.0  # [sd] width of the Cauchy cost
ROBUST_GRAPH_GROWTH = 1.4  # of the control parameter, a round
ROBUST_GRAPH_TAILS = 10.0  # times the scatter told by the middle edge, which real edges' tails may exceed,
ROBUST_GRAPH_NARROWEST = 0.1  # of what edges say of themselves at least, and
ROBUST_GRAPH_ENOUGH = 30  # edges for the middle one to tell anything

REVISIONS = 60  # solves at most, while edges that were dropped fit again or ones that are believed do not
SAME = 1e-6  # relative difference of the costs of two minima that are the same
HOLDS_ALONE = 1e-6  # share of an edge's covariance that is left over: less, and nothing else tells what it tells
FADED = 1e-8  # what a dropped edge counts while weights are sought: the graph stays in one piece


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustGraphConfig:
    """How edges that contradict the rest are found.

    none: no edge is dropped. cauchy: one robust solve, then what lies beyond the gate goes. gnc: graduated
    non-convexity [Yang20] on truncated squares, which also finds its way out of many false edges.
    """

    method: Literal["none", "cauchy", "gnc"] = "gnc"


@dataclass(frozen=True, slots=True)
class Prior:
    """Pose `vertex` is known to be at `pose` (3,) in `map` with `information` (3, 3), in that pose's frame."""

    vertex: int
    pose: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, slots=True)
class DroppedEdge:
    """Edge number `edge` is not believed. nis: its squared residual, in sd, at the solution without it."""

    edge: int
    first: int
    second: int
    nis: float
    reason: str


@dataclass(frozen=True, slots=True)
class SolvedGraph:
    """A pose graph at its optimum.

    graph: the same edges with the poses solved; used: (m,) which edges the solution rests on; nis: (m,) squared
    residual of each, in sd; prior_nis: (k,) squared distance of each prior from the solution without it, fixed_nis:
    (f,) of each of `fixed` from where the first of its part and the rest put it, in sd; component: (n,) which poses
    are connected through edges that are used, 0 the one of the first fixed pose; fixed: poses held; chi2, chi2_before:
    sum of squares of the used edges and the priors, at the optimum and with the poses given; rounds: solves made to
    find which edges contradict.
    """

    graph: PoseGraph
    used: Bool[np.ndarray, " m"]
    nis: Float[np.ndarray, " m"]
    prior_nis: Float[np.ndarray, " k"]
    fixed_nis: Float[np.ndarray, " f"]
    component: Int[np.ndarray, " n"]
    fixed: tuple[int, ...]
    dropped: tuple[DroppedEdge, ...]
    chi2_before: float
    chi2: float
    dof: int
    iterations: int
    rounds: int
    status: SolveStatus
    solution: Solution = field(repr=False)

    @property
    def converged(self) -> bool:
        return self.status is SolveStatus.CONVERGED

    def covariances(self) -> Float[np.ndarray, "n 3 3"]:
        """The covariance of every pose over x, y, theta in `map`; zero where it is held."""
        n = len(self.graph)
        return self.solution.blocks(np.arange(3 * n).reshape(-1, 3)) if len(self.solution.free) else np.zeros((n, 3, 3))

    def relative_covariances(
        self, first: Int[np.ndarray, " p"], second: Int[np.ndarray, " p"]
    ) -> Float[np.ndarray, "p 3 3"]:
        """Covariance of `between(pose first, pose second)` for every pair, in second's place seen from first."""
        columns = np.concatenate([_columns(first), _columns(second)], axis=1)
        joint = np.stack([self.solution.covariance(c) for c in columns]) if len(columns) else np.zeros((0, 6, 6))
        A, B = se2.between_jacobians(self.graph.pose[first], self.graph.pose[second])
        J = np.concatenate([A, B], axis=2)
        return np.asarray(J @ joint @ J.swapaxes(1, 2))


def solve_graph(
    graph: PoseGraph,
    cfg: RobustGraphConfig | None = None,
    *,
    fixed: Sequence[int] = (),
    priors: Sequence[Prior] = (),
    doubtful: Bool[np.ndarray, " m"] | None = None,
    unasked: Bool[np.ndarray, " m"] | None = None,
) -> SolvedGraph:
    """The optimum of `graph`, from the poses it has.

    fixed: poses held where they are; without these and without priors the first one is. doubtful: (m,) the edges that
    may be dropped; without, all that do not tie a pose to the next. unasked: (m,) those of them that are believed only
    where they fit what the others say. Of every connected part one pose at least is held. Raises DataError when an
    information matrix is not positive definite or a number is not finite.
    """
    cfg = cfg or RobustGraphConfig()
    _check(graph, fixed, priors)
    held = tuple(sorted({*fixed})) or (() if priors else (0,))
    may = (np.abs(graph.second - graph.first) != 1) if doubtful is None else doubtful
    asked = np.ones(graph.edges, dtype=bool) if unasked is None else ~unasked
    used, rounds, iterations, x = asked, 0, 0, graph.pose
    if cfg.method != "none" and (may & asked).any():
        used, x, rounds, iterations = _believed(graph, cfg, held, priors, may, asked)
    first, refused = held, np.zeros(graph.edges, dtype=bool)
    for _ in range(REVISIONS):
        component, held = _components(graph, used, first, priors)
        problem = _problem(replace(graph, pose=x), used.astype(float), held, priors, None)
        solution = minimise(problem, ROBUST_SOLVE, Pattern.of(problem).in_threes())
        iterations += solution.iterations
        if cfg.method != "none":
            again = minimise(replace(problem, x0=graph.pose.ravel()), ROBUST_SOLVE, Pattern.of(problem).in_threes())
            iterations += again.iterations
            solution = again if again.cost < (1.0 - SAME) * solution.cost else solution
        x = solution.x.reshape(-1, 3)
        now = replace(graph, pose=x)
        back = ~used & ~refused & (_squares(now) <= CONTRADICTION)
        used = used | back  # an edge that fits once the others are gone is believed again
        if back.any():
            continue
        worst = None if cfg.method == "none" else _worst(now, solution, used & may)
        if worst is None:
            break
        used[worst], refused[worst] = False, True
    solved = replace(graph, pose=x)
    nis, before = _squares(solved), _squares(graph)
    middle = float(np.median(nis[used & may])) if (used & may).any() else 0.0
    prior_before = _prior_squares(priors, graph.pose)
    return SolvedGraph(
        graph=solved,
        used=frozen(used, bool),
        nis=frozen(nis),
        prior_nis=frozen(_left_out_priors(priors, solution)),
        fixed_nis=frozen(_fixed_squares(solved, used, component, held, priors)),
        component=frozen(component, np.int64),
        fixed=held,
        dropped=tuple(_dropped(graph, k, float(nis[k]), CONTRADICTION, middle) for k in np.flatnonzero(~used).tolist()),
        chi2_before=float(before[used].sum() + prior_before.sum()),
        chi2=solution.chi2,
        dof=solution.dof,
        iterations=iterations,
        rounds=rounds,
        status=solution.status,
        solution=solution,
    )


def _believed(
    graph: PoseGraph,
    cfg: RobustGraphConfig,
    held: tuple[int, ...],
    priors: Sequence[Prior],
    may: np.ndarray,
    asked: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """(which of the edges `asked` are believed (m,), poses (n, 3), solves, iterations)."""
    _, held = _components(graph, asked, held, priors)
    weight, may = asked.astype(float), may & asked
    if cfg.method == "cauchy":
        problem = _problem(graph, weight, held, priors, Cauchy(ROBUST_GRAPH_KERNEL), may)
        solution = minimise(problem, ROBUST_SOLVE, Pattern.of(problem).in_threes())
        pose = solution.x.reshape(-1, 3)
        beyond = may & (_squares(replace(graph, pose=pose)) > CONTRADICTION)
        return asked & ~beyond, pose, 1, solution.iterations
    step = replace(ROBUST_SOLVE, max_iterations=10, step_tolerance=1e-5, cost_tolerance=1e-5)
    pattern = Pattern.of(_problem(graph, weight, held, priors, None)).in_threes()
    pose, iterations, control = graph.pose, 0, 0.0
    for rounds in range(1, MOST_ROUNDS + 1):
        problem = _problem(replace(graph, pose=pose), weight, held, priors, None)
        solution = minimise(problem, step, pattern)
        pose, iterations = solution.x.reshape(-1, 3), iterations + solution.iterations
        s = _squares(replace(graph, pose=pose))
        if rounds == 1:
            worst = float(s[may].max())
            if worst <= CONTRADICTION:
                return asked, pose, rounds, iterations
            control = CONTRADICTION / (2.0 * worst - CONTRADICTION)  # [Yang20] remark 5
        high = (control + 1.0) / control * CONTRADICTION
        before, weight = weight, np.where(may, truncated_weights(s, CONTRADICTION, control), asked)
        control *= ROBUST_GRAPH_GROWTH
        decided = bool(((weight > 1.0 - 1e-6) | (weight <= FADED)).all())
        settled = solution.converged and np.array_equal(weight, before)  # a harder kernel would change none of them
        if decided and (settled or high < 1.05 * CONTRADICTION):
            break
    s = _squares(replace(graph, pose=pose))
    return asked & (~may | (s <= CONTRADICTION)), pose, rounds, iterations


def _worst(graph: PoseGraph, solution: Solution, asked: np.ndarray) -> int | None:
    """Of the edges `asked` the one that contradicts all others most, if it does beyond what chance gives.

    A false edge that bends the graph to itself fits: it shows by how far it lies from the solution without it. Where
    edges scatter less than they say, less is a contradiction.
    """
    rows = np.flatnonzero(asked)
    if not len(rows) or solution.information is None:
        return None
    nis = left_out_squares(graph, solution, rows)
    worst = int(np.argmax(nis))
    scatter = float(np.median(nis)) / chi2_quantile(0.5, 3.0)
    narrower = (
        min(1.0, max(ROBUST_GRAPH_TAILS * scatter, ROBUST_GRAPH_NARROWEST)) if len(rows) >= ROBUST_GRAPH_ENOUGH else 1.0
    )
    limit = chi2_quantile(1.0 - EDGE_CHANCE / len(rows), 3.0) * narrower
    return int(rows[worst]) if nis[worst] > limit else None


def _left_out_priors(priors: Sequence[Prior], solution: Solution) -> Float[np.ndarray, " k"]:
    """How far each prior lies from the solution without it [squared sd]."""
    if not priors or solution.information is None:
        return _prior_squares(priors, solution.x.reshape(-1, 3))
    at = np.array([p.vertex for p in priors])
    P = solution.blocks(_columns(at))
    z = np.array([p.pose for p in priors])
    pose = solution.x.reshape(-1, 3)[at]
    return without_it(
        se2.between(z, pose), se2.between_jacobians(z, pose)[1], P, np.array([p.information for p in priors])
    )


def left_out_squares(graph: PoseGraph, solution: Solution, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """How far edges `rows`, which `solution` rests on, lie from the solution without each [squared sd].

    What bends the solution to itself has a small residual and may be false all the same: the residual is weighed with
    what is left of its covariance when that of the prediction is taken off. With residual r, covariance R and that of
    what is predicted J P J^T it is `r^T (R - J P J^T)^-1 r`; 0 in directions that no other edge tells.
    """
    i, j = graph.first[rows], graph.second[rows]
    block = np.full(len(graph), -1)
    block[solution.free[::3] // 3] = np.arange(len(solution.free) // 3)
    both = (block[i] >= 0) & (block[j] >= 0)
    diagonal, tied = _factor(solution).pairs(block[i][both], block[j][both])
    at_home = np.concatenate([diagonal, np.zeros((1, 3, 3))])  # a pose that is held: number -1
    P = np.zeros((len(rows), 6, 6))
    P[:, :3, :3], P[:, 3:, 3:] = at_home[block[i]], at_home[block[j]]
    P[both, :3, 3:], P[both, 3:, :3] = tied, tied.swapaxes(1, 2)
    A, B = se2.between_jacobians(graph.pose[i], graph.pose[j])
    J = se2.turn(-graph.measured[rows, 2]) @ np.concatenate([A, B], axis=2)
    r = se2.between(graph.measured[rows], se2.between(graph.pose[i], graph.pose[j]))
    return without_it(r, J, P, graph.information[rows])


def without_it(
    r: Float[np.ndarray, "k 3"],
    J: Float[np.ndarray, "k 3 d"],
    P: Float[np.ndarray, "k d d"],
    information: Float[np.ndarray, "k 3 3"],
) -> Float[np.ndarray, " k"]:
    """`r^T (R - J P J^T)^-1 r` [squared sd] with R the inverse of `information`; 0 in directions nothing else tells."""
    W = np.linalg.cholesky(information).swapaxes(1, 2)
    M = np.eye(3) - W @ (J @ P @ J.swapaxes(1, 2)) @ W.swapaxes(1, 2)
    values, vectors = np.linalg.eigh(0.5 * (M + M.swapaxes(1, 2)))
    along = (vectors.swapaxes(1, 2) @ (W @ r[..., None]))[..., 0]
    left = values > HOLDS_ALONE
    return np.asarray((np.square(along) * left / np.where(left, values, 1.0)).sum(axis=1))


def _factor(solution: Solution) -> BlockCholesky:
    assert solution.information is not None  # noqa: S101  (asked before)
    factor: BlockCholesky = solution.information.factor
    return factor


def _fixed_squares(
    graph: PoseGraph,
    used: np.ndarray,
    component: np.ndarray,
    held: tuple[int, ...],
    priors: Sequence[Prior],
) -> Float[np.ndarray, " f"]:
    """How far each pose held lies from where the rest puts it when only the first of its part is held [squared sd]."""
    at = np.array(held, dtype=np.int64)
    nis = np.zeros(len(at))
    first = [int(at[component[at] == c][0]) for c in np.unique(component[at])]
    if len(first) == len(at):
        return nis
    problem = _problem(graph, used.astype(float), first, priors, None)
    free = minimise(problem, ROBUST_SOLVE, Pattern.of(problem).in_threes())
    if free.information is None:
        return nis
    other = np.flatnonzero(~np.isin(at, first))
    P = free.blocks(_columns(at[other]))
    off = graph.pose[at[other]] - free.x.reshape(-1, 3)[at[other]]
    off[:, 2] = se2.wrap_angle(off[:, 2])
    nis[other] = (off * np.linalg.solve(P, off[..., None])[..., 0]).sum(axis=1)
    return nis


def truncated_weights(s: Float[np.ndarray, " m"], gate: float, control: float) -> Float[np.ndarray, " m"]:
    """What edges of squared residuals `s` count when squares beyond `gate` are truncated, the more softly the smaller
    `control` is [Yang20] eq. 14: the w in (0, 1] of least `w s + gate control (1 - w) / (control + w)`.
    """
    low, high = control / (control + 1.0) * gate, (control + 1.0) / control * gate
    between = np.sqrt(gate * control * (control + 1.0) / np.maximum(s, 1e-300)) - control
    return np.where(s <= low, 1.0, np.where(s >= high, FADED, np.clip(between, FADED, 1.0)))


def _problem(
    graph: PoseGraph,
    weight: np.ndarray,
    held: Sequence[int],
    priors: Sequence[Prior],
    kernel: Kernel | None,
    robust: np.ndarray | None = None,
) -> Problem:
    """Edges of weight 0 are left out; `kernel` is for the edges `robust`."""
    there = weight > 0
    parts: list[tuple[np.ndarray, Kernel | None]] = [(there, None)]
    if robust is not None:
        parts = [(there & ~robust, None), (there & robust, kernel)]
    terms: list[Term] = []
    for rows, shape in parts:
        if rows.any():
            parts_of = graph.first[rows], graph.second[rows], graph.measured[rows], graph.information[rows]
            terms.append(PoseEdges(PoseGraph(graph.pose, *parts_of), weight[rows], shape))
    if priors:
        terms.append(_prior_factor(priors))
    mask = np.zeros(3 * len(graph), dtype=bool)
    mask[_columns(np.array(held, dtype=np.int64))] = True
    return Problem(graph.pose.ravel(), terms, mask, wrapping(np.arange(2, 3 * len(graph), 3)))


def _prior_factor(priors: Sequence[Prior]) -> Factor:
    columns = _columns(np.array([p.vertex for p in priors]))
    z = np.array([p.pose for p in priors])
    W = np.linalg.cholesky(np.array([p.information for p in priors])).swapaxes(1, 2)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(se2.between(z, x[columns]))

    def jacobian(x: np.ndarray) -> np.ndarray:
        return se2.between_jacobians(z, x[columns])[1]

    return Factor(columns, residual, jacobian, 3, W, None, "priors")


def _prior_squares(priors: Sequence[Prior], pose: np.ndarray) -> np.ndarray:
    return _prior_factor(priors).squares(pose.ravel()) if priors else np.zeros(0)


def _squares(graph: PoseGraph) -> np.ndarray:
    return PoseEdges(graph, np.ones(graph.edges)).squares(graph.pose.ravel())


def _columns(poses: np.ndarray) -> np.ndarray:
    return np.asarray(3 * np.asarray(poses)[:, None] + np.arange(3))


def _components(
    graph: PoseGraph, used: np.ndarray, held: tuple[int, ...], priors: Sequence[Prior]
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Which poses are connected, numbered from that of the first held one, and the poses held, one a component."""
    component = connected(graph, used)
    order = [int(component[k]) for k in (*held, *(p.vertex for p in priors))]
    seen = dict.fromkeys([*order, *component.tolist()])
    number = np.empty(len(seen), dtype=np.int64)
    number[list(seen)] = np.arange(len(seen))
    component = number[component]
    loose = sorted(set(component.tolist()) - {int(number[k]) for k in order})
    return component, tuple(sorted({*held, *(int(np.argmax(component == k)) for k in loose)}))


def connected(graph: PoseGraph, used: Bool[np.ndarray, " m"] | None = None) -> Int[np.ndarray, " n"]:
    """A number for every pose, equal for those connected through the edges `used` (all when None)."""
    rows = np.ones(graph.edges, dtype=bool) if used is None else used
    n = len(graph)
    links = sp.coo_array((np.ones(int(rows.sum())), (graph.first[rows], graph.second[rows])), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _dropped(graph: PoseGraph, k: int, nis: float, gate: float, middle: float) -> DroppedEdge:
    i, j = int(graph.first[k]), int(graph.second[k])
    limit = f"the limit is {np.sqrt(gate):.1f}" if nis > gate else f"most others {np.sqrt(middle):.2f}"
    reason = f"it lies {np.sqrt(nis):.1f} standard deviations from what the rest says, {limit}"
    return DroppedEdge(k, i, j, nis, reason)


def _check(graph: PoseGraph, fixed: Sequence[int], priors: Sequence[Prior]) -> None:
    n = len(graph)
    if not n:
        raise DataError("a pose graph needs poses, found none")
    for name, values in (("pose", graph.pose), ("measured", graph.measured), ("information", graph.information)):
        if not np.isfinite(values).all():
            raise DataError(f"pose graph: a number of `{name}` is not finite")
    ends = np.concatenate([graph.first, graph.second, [*fixed], [p.vertex for p in priors]])
    if len(ends) and (ends.min() < 0 or ends.max() >= n):
        raise DataError(
            f"pose graph: expected vertices 0 to {n - 1}, found {int(ends.max() if ends.max() >= n else ends.min())}"
        )
    if (graph.first == graph.second).any():
        k = int(np.argmax(graph.first == graph.second))
        raise DataError(f"pose graph: edge {k} ties pose {int(graph.first[k])} to itself")
    for what, information in (("edge", graph.information), ("prior", np.array([p.information for p in priors]))):
        if len(information) and (np.linalg.eigvalsh(information)[:, 0] <= 0).any():
            k = int(np.argmax(np.linalg.eigvalsh(information)[:, 0] <= 0))
            raise DataError(f"pose graph: the information of {what} {k} is not positive definite")
