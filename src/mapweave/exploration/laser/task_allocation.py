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
from .frontiers import Frontier, Ground, nearest_cells
from .planner_state import SAME, Crew, priced
from .view import LaserExploreConfig

FAR = 1e4  # [m], stands for a place that no way leads to
RING = np.array([(y, x) for y in range(-2, 3) for x in range(-2, 3) if max(abs(y), abs(x)) == 2])
STILL = 1.5  # [m], how far what is left of a piece may be from the goal that was made of it
ON_THE_WAY = 1.0  # [m], a detour that small is none
TURN = 0.6  # [m / rad], what turning towards a goal costs


@dataclass(frozen=True, slots=True)
class Offers:
    """Pieces of frontier and how far they are. robots: (m,) who may go; first: (m, n) [m] from each robot, its turn
    towards the piece counted; between: (n, n) [m]; FAR where no way leads; held: robot -> piece it heads for already.
    """

    pieces: list[Frontier]
    robots: tuple[int, ...]
    first: Float[np.ndarray, "m n"]
    between: Float[np.ndarray, "n n"]
    poses: Float[np.ndarray, "m 3"]
    ground: Ground
    held: dict[int, int]


Share = Callable[[Offers, LaserExploreConfig], dict[int, int]]


def offer(
    ground: Ground, pieces: list[Frontier], crew: Crew, poses: np.ndarray, live: np.ndarray, cfg: LaserExploreConfig
) -> Offers:
    """All ways between live robots and pieces, over cells twice as large: shares need no exact lengths."""
    weight = halved(priced(ground, parked(crew, poses, live), cfg))
    metre = 2 * ground.grid.resolution / STRAIGHT
    places = np.vstack([poses[live, :2], *(f.place[None] for f in pieces)])
    fine = nearest_cells(ground.grid, ground.weight > 0, places)
    cells = fine // 2
    m = len(live)
    costs = [spread(weight, cells[m + n : m + n + 1], NO_LIMIT) for n in range(len(pieces))]
    found = np.array([c[tuple(cells.T)] for c in costs], dtype=float)
    metres = np.where((found >= 0) & (fine[:, 0] >= 0), found * metre, FAR).T
    first = metres[:m].copy()
    for r, j in enumerate(live):
        away = departures(costs, cells[r])
        first[r] += np.where(np.isfinite(away), TURN * np.abs(wrap_angle(np.nan_to_num(away) - poses[j, 2])), 0.0)
    return Offers(pieces, tuple(map(int, live)), first, metres[m:], poses[live], ground, _held(crew, pieces))


def parked(crew: Crew, poses: np.ndarray, live: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Places of live robots that stand idle: they are gone round where that is possible."""
    return np.asarray(poses[[j for j in live if j not in crew.goals and crew.still[j] > 5], :2])


def halved(weight: np.ndarray) -> np.ndarray:
    """`weight` over cells twice as large: blocked where all four are, else the mean of those that are not.

    Walls stay shut, since a robot's width is blocked on both sides of them.
    """
    padded = np.pad(weight, [(0, n % 2) for n in weight.shape]).astype(np.uint16)
    four = np.stack([padded[a::2, b::2] for a in (0, 1) for b in (0, 1)])
    return np.asarray((four.sum(axis=0) / np.maximum((four > 0).sum(axis=0), 1)).round(), dtype=np.uint8)


def departures(costs: list[np.ndarray], cell: np.ndarray) -> Float[np.ndarray, " n"]:
    """Direction [rad] (n,) in which the way down each of `costs` leaves `cell`; NaN where it is there or unreached."""
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


def _held(crew: Crew, pieces: list[Frontier]) -> dict[int, int]:
    """Robot -> what is left of the piece it heads for: the one with unknown cells nearest to its goal."""
    out: dict[int, int] = {}
    for j, goal in crew.goals.items():
        away = [np.hypot(*(f.unknown - goal.place).T).min() for f in pieces]
        if not goal.done and away and min(away) < STILL:
            out[j] = int(np.argmin(away))
    return out


def hold(offers: Offers, chosen: dict[int, int], cfg: LaserExploreConfig) -> dict[int, int]:
    """`chosen`, but who is on the way to a piece goes on, unless another robot does it, or the new one is nearer by
    `keep` or lies on the way. Since every change of mind brings a goal nearer there is no driving to and fro.
    """
    out = dict(chosen)
    row = {j: r for r, j in enumerate(offers.robots)}
    for j, h in offers.held.items():
        n = out.get(j)
        far = offers.first[row[j], h]
        if n == h or j not in row or far >= FAR / 2:
            continue
        who = next((i for i in out if i != j and out[i] == h), None)
        if who is not None and offers.first[row[who], h] < far:
            continue
        if n is not None:
            to = offers.first[row[j], n]
            if to < far - cfg.keep or to + offers.between[n, h] < far + ON_THE_WAY:
                continue
        out[j] = h
        if who is not None and n is not None:
            out[who] = n
        elif who is not None:
            del out[who]
    return out


def by_tours(offers: Offers, cfg: LaserExploreConfig) -> dict[int, int]:
    """Robot -> piece: the first of its tour, the tours short in the longest and then in the sum."""
    first, between = offers.first + cfg.service, offers.between + cfg.service
    tours, counts = balanced_tours(first, between, np.zeros_like(first))
    improve_tours(first, between, tours, counts)
    chosen = {j: int(tours[r, 0]) for r, j in enumerate(offers.robots) if counts[r]}
    return {j: n for j, n in chosen.items() if offers.first[offers.robots.index(j), n] < FAR / 2}


def nearest_first(offers: Offers, cfg: LaserExploreConfig) -> dict[int, int]:
    """Robot -> piece: the shortest way of all first; a piece goes to one robot."""
    del cfg
    left = offers.first.copy()
    out: dict[int, int] = {}
    while left.size and left.min() < FAR / 2:
        r, n = np.unravel_index(np.argmin(left), left.shape)
        out[offers.robots[r]] = int(n)
        left[r], left[:, n] = FAR, FAR
    return out


def by_objective(w_accuracy: float) -> Share:
    """Shares by `J = w1 walls + w2 area + w3 apart - way`, each in [0, 1], one robot after the other."""

    def share(offers: Offers, cfg: LaserExploreConfig) -> dict[int, int]:
        walls, area = sights(offers, cfg)
        out: dict[int, int] = {}
        taken: list[np.ndarray] = []
        for r, j in enumerate(offers.robots):
            J = w_accuracy * walls + cfg.w_area * area - cfg.w_way * offers.first[r] / 20.0
            others = [*taken, *offers.poses[r + 1 :, :2]]
            if others:
                d = np.array([[np.hypot(*(f.place - o)) for o in others] for f in offers.pieces])
                J = J + cfg.w_apart * np.minimum(d / (2 * cfg.reach), 1.0).mean(axis=1)
                J = J - np.array(
                    [1.0 if any(np.hypot(*(f.place - o)) < SAME for o in taken) else 0.0 for f in offers.pieces]
                )
            J = np.where(offers.first[r] < FAR / 2, J, -np.inf)
            if len(J) and np.isfinite(J.max()):
                best = int(np.argmax(J))
                out[j] = best
                taken.append(offers.pieces[best].place)
        return out

    return share


def sights(offers: Offers, cfg: LaserExploreConfig) -> tuple[np.ndarray, np.ndarray]:
    """For each piece, in [0, 1]: known walls around it, which a scan there can be matched to, and unknown ground."""
    grid = offers.ground.grid
    side = 2 * int(0.5 * cfg.reach / grid.resolution) + 1
    cells = grid.cells(np.array([f.place for f in offers.pieces]).reshape(-1, 2))
    found = [
        ndimage.uniform_filter(mask.astype(np.float32), side, mode="constant")[tuple(cells.T)]
        for mask in (grid.occupied, grid.unknown & offers.ground.fits)
    ]
    return tuple(x / x.max() if x.size and x.max() > 0 else x for x in found)
