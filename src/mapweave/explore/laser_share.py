"""Who goes to which frontier."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..core.se2 import wrap_angle
from ..kernels.tour_moves import improve_tours
from ..kernels.tours import balanced_tours
from ..kernels.wavefront import STRAIGHT
from .frontiers import Frontier, Ground, nearest_cells
from .laser_crew import SAME, Crew, Ways, ways_to
from .laser_view import LaserExploreConfig

FAR = 1e4  # [m], stands for a place that no way leads to
STILL = 1.5  # [m], how far what is left of a piece may be from the goal that was made of it
ON_THE_WAY = 1.0  # [m], a detour that small is none
TURN = 0.6  # [m / rad], what turning towards a goal costs


@dataclass(frozen=True, slots=True)
class Offers:
    """Pieces of frontier and how far they are. robots: (m,) who may go; first: (m, n) [m] from each robot, its turn
    towards the piece counted; between: (n, n) [m]; FAR where no way leads; held: robot -> piece it heads for already.
    """

    pieces: list[Frontier]
    ways: list[Ways]
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
    """All ways between live robots and pieces; robots that stand idle are gone round where that is possible."""
    parked = poses[[j for j in live if j not in crew.goals and crew.still[j] > 5], :2]
    ways = [ways_to(ground, f.place, parked, cfg) for f in pieces]
    places = np.vstack([poses[live, :2], *(f.place[None] for f in pieces)])
    cells = nearest_cells(ground.grid, ground.weight > 0, places)
    cost = np.array([w.cost[tuple(cells.T)] for w in ways], dtype=float)
    metres = np.where((cost >= 0) & (cells[:, 0] >= 0), cost * ground.grid.resolution / STRAIGHT, FAR).T
    m = len(live)
    first, between = metres[:m].copy(), metres[m:]
    for r, j in enumerate(live):
        for n in range(len(pieces)):
            if first[r, n] >= FAR:
                continue
            to = ways[n].target(poses[j, :2], 1.0)
            if to is not None and np.hypot(*(to - poses[j, :2])) > 0.2:
                d = to - poses[j, :2]
                first[r, n] += TURN * abs(wrap_angle(np.arctan2(d[1], d[0]) - poses[j, 2]))
    return Offers(pieces, ways, tuple(map(int, live)), first, between, poses[live], ground, _held(crew, pieces))


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
