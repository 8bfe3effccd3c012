"""Who goes to which frontier."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ...core.se2 import wrap_angle
from ...kernels.exploration.tour_moves import improve_tours
from ...kernels.exploration.tours import balanced_tours
from ...kernels.exploration.wavefront import NO_LIMIT, STRAIGHT, spread
from ..ground import FAR
from .config import LaserExploreConfig
from .frontiers import Frontier, MappedGround
from .planner_state import PlannerState, with_parked

RING = np.array([(y, x) for y in range(-2, 3) for x in range(-2, 3) if max(abs(y), abs(x)) == 2])


@dataclass(frozen=True, slots=True)
class AllocationProblem:
    """Pieces of frontier and how far they are. robots: (m,) who may go; first: (m, n) [m] from each robot, its turn
    towards the piece counted; between: (n, n) [m]; FAR where no path leads; held: robot -> piece it heads for already.
    """

    pieces: list[Frontier]
    robots: tuple[int, ...]
    first: Float[np.ndarray, "m n"]
    between: Float[np.ndarray, "n n"]
    poses: Float[np.ndarray, "m 3"]
    ground: MappedGround
    held: dict[int, int]


Allocator = Callable[[AllocationProblem, LaserExploreConfig], dict[int, int]]


def allocation_problem(
    ground: MappedGround,
    pieces: list[Frontier],
    state: PlannerState,
    poses: np.ndarray,
    live: np.ndarray,
    cfg: LaserExploreConfig,
) -> AllocationProblem:
    """All paths between live robots and pieces, over cells twice as large: shares need no exact lengths."""
    weight = halved(with_parked(ground, parked(state, poses, live), cfg).weight)
    metre = 2 * ground.grid.resolution / STRAIGHT
    places = np.vstack([poses[live, :2], *(f.place[None] for f in pieces)])
    fine = ground.cells(places)
    cells = fine // 2
    m = len(live)
    costs = [spread(weight, cells[m + n : m + n + 1], NO_LIMIT) for n in range(len(pieces))]
    cost = np.array([c[tuple(cells.T)] for c in costs], dtype=float)
    metres = np.where((cost >= 0) & (fine[:, 0] >= 0), cost * metre, FAR).T
    first = metres[:m].copy()
    for r, j in enumerate(live):
        away = departures(costs, cells[r])
        first[r] += np.where(
            np.isfinite(away), cfg.allocation.turn_cost * np.abs(wrap_angle(np.nan_to_num(away) - poses[j, 2])), 0.0
        )
    return AllocationProblem(
        pieces, tuple(map(int, live)), first, metres[m:], poses[live], ground, _held(state, pieces, cfg)
    )


def parked(state: PlannerState, poses: np.ndarray, live: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Places of live robots that stand idle: they are gone round where that is possible."""
    return np.asarray(poses[[j for j in live if j not in state.goals and state.still[j] > 5], :2])


def halved(weight: np.ndarray) -> np.ndarray:
    """`weight` over cells twice as large: blocked where all four are, else the mean of those that are not.

    Walls stay shut, since a robot's width is blocked on both sides of them.
    """
    padded = np.pad(weight, [(0, n % 2) for n in weight.shape]).astype(np.uint16)
    four = np.stack([padded[a::2, b::2] for a in (0, 1) for b in (0, 1)])
    return np.asarray((four.sum(axis=0) / np.maximum((four > 0).sum(axis=0), 1)).round(), dtype=np.uint8)


def departures(costs: list[np.ndarray], cell: np.ndarray) -> Float[np.ndarray, " n"]:
    """Direction [rad] (n,) in which the path down each of `costs` leaves `cell`; NaN where it is there or unreached."""
    rows, cols = costs[0].shape
    ring = cell + RING
    inside = np.all((ring >= 0) & (ring < (rows, cols)), axis=1)
    y, x = ring[inside].T
    around = np.array([c[y, x] for c in costs], dtype=float)
    here = np.array([c[tuple(cell)] for c in costs], dtype=float)
    around[around < 0] = np.inf
    best = np.argmin(around, axis=1)
    angle = np.arctan2(*RING[inside][best].T.astype(float))
    return np.where((here > 0) & (around[np.arange(len(costs)), best] < here), angle, np.nan)


def _held(state: PlannerState, pieces: list[Frontier], cfg: LaserExploreConfig) -> dict[int, int]:
    """Robot -> what is left of the piece it heads for: the one with unknown cells nearest to its goal."""
    out: dict[int, int] = {}
    for j, goal in state.goals.items():
        away = [np.hypot(*(f.unknown - goal.place).T).min() for f in pieces]
        if not goal.done and away and min(away) < cfg.allocation.same_piece:
            out[j] = int(np.argmin(away))
    return out


def keep_commitments(problem: AllocationProblem, chosen: dict[int, int], cfg: LaserExploreConfig) -> dict[int, int]:
    """`chosen`, but who is on the way to a piece goes on, unless another robot does it, or the new one is nearer by
    `keep` or lies on the way. Since every change of mind brings a goal nearer there is no driving to and fro.
    """
    out = dict(chosen)
    row = {j: r for r, j in enumerate(problem.robots)}
    for j, h in problem.held.items():
        n = out.get(j)
        far = problem.first[row[j], h]
        if n == h or j not in row or far >= FAR / 2:
            continue
        who = next((i for i in out if i != j and out[i] == h), None)
        if who is not None and problem.first[row[who], h] < far:
            continue
        if n is not None:
            to = problem.first[row[j], n]
            if to < far - cfg.keep or to + problem.between[n, h] < far + cfg.allocation.on_the_way:
                continue
        out[j] = h
        if who is not None and n is not None:
            out[who] = n
        elif who is not None:
            del out[who]
    return out


def by_tours(problem: AllocationProblem, cfg: LaserExploreConfig) -> dict[int, int]:
    """Robot -> piece: the first of its tour, the tours short in the longest and then in the sum."""
    first, between = (np.ascontiguousarray(cost + cfg.service) for cost in (problem.first, problem.between))
    tours, counts = balanced_tours(first, between, np.zeros_like(first), cfg.allocation.balance)
    improve_tours(first, between, tours, counts, cfg.allocation.stretch)
    chosen = {j: int(tours[r, 0]) for r, j in enumerate(problem.robots) if counts[r]}
    return {j: n for j, n in chosen.items() if problem.first[problem.robots.index(j), n] < FAR / 2}


def nearest_first(problem: AllocationProblem, cfg: LaserExploreConfig) -> dict[int, int]:
    """Robot -> piece: the shortest path of all first; a piece goes to one robot."""
    del cfg
    left = problem.first.copy()
    out: dict[int, int] = {}
    while left.size and left.min() < FAR / 2:
        r, n = np.unravel_index(np.argmin(left), left.shape)
        out[problem.robots[r]] = int(n)
        left[r], left[:, n] = FAR, FAR
    return out


def by_objective(w_accuracy: float) -> Allocator:
    """Allocates by `J = w1 walls + w2 area + w3 apart - way`, each in [0, 1], one robot after the other."""

    def allocate(problem: AllocationProblem, cfg: LaserExploreConfig) -> dict[int, int]:
        walls, area = walls_and_area(problem, cfg)
        out: dict[int, int] = {}
        taken: list[np.ndarray] = []
        for r, j in enumerate(problem.robots):
            J = w_accuracy * walls + cfg.w_area * area - cfg.w_way * problem.first[r] / 20.0
            others = [*taken, *problem.poses[r + 1 :, :2]]
            if others:
                d = np.array([[np.hypot(*(f.place - o)) for o in others] for f in problem.pieces])
                J = J + cfg.w_apart * np.minimum(d / (2 * cfg.reach), 1.0).mean(axis=1)
                J = J - np.array(
                    [
                        1.0 if any(np.hypot(*(f.place - o)) < cfg.goals.same for o in taken) else 0.0
                        for f in problem.pieces
                    ]
                )
            J = np.where(problem.first[r] < FAR / 2, J, -np.inf)
            if len(J) and np.isfinite(J.max()):
                best = int(np.argmax(J))
                out[j] = best
                taken.append(problem.pieces[best].place)
        return out

    return allocate


def walls_and_area(problem: AllocationProblem, cfg: LaserExploreConfig) -> tuple[np.ndarray, np.ndarray]:
    """For each piece, in [0, 1]: known walls around it, which a scan there can be matched to, and unknown ground."""
    grid = problem.ground.grid
    side = 2 * int(0.5 * cfg.reach / grid.resolution) + 1
    cells = grid.cells(np.array([f.place for f in problem.pieces]).reshape(-1, 2))
    terms = [
        ndimage.uniform_filter(mask.astype(np.float32), side, mode="constant")[tuple(cells.T)]
        for mask in (grid.occupied, grid.unknown & problem.ground.fits)
    ]
    return tuple(x / x.max() if x.size and x.max() > 0 else x for x in terms)
