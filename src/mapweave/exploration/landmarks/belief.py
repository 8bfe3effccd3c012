"""What a planner knows of a landmark world, and the planners by name: `choose(maps, poses, cfg) -> commands`.

Which cells of a rectangle a team has seen, by whom, and whether that knowledge is safe in the global map. Robots that
plan together know one map, what was seen, and what those beyond the radio's range last heard: submaps are independent
of each other and of every map, so that is a set of submaps; two that meet have the union of theirs, and a map made of
it counts nothing twice, however often they parted and met.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import se2
from ...fusion.handover import Handover, PairingConfig, hand_over, without_frames
from ...kernels.walls.segments import Raster
from ...landmarks.landmark_map import GlobalMap, Submap
from ..planner_interface import TeamBelief
from .config import ExploreConfig
from .floor_plan import FloorPlan


@dataclass(slots=True)
class Explored:
    """Seen cells of one run; the only mutable object of exploration, owned by its loop.

    fused: (ny, nx) cells whose sightings are in the global map; pending: (M, ny, nx) delivered to the team, in a submap
    still; backlog: (M, ny, nx) not delivered yet. Lost with a robot: its pending and backlog cells.
    sweeps counts passes over the rectangle. outside: (ny, nx) cells that are no part of the field, None without any.
    """

    lower: Float[np.ndarray, "2"]
    cell: float
    fused: Bool[np.ndarray, "ny nx"]
    pending: Bool[np.ndarray, "r ny nx"]
    backlog: Bool[np.ndarray, "r ny nx"]
    sweeps: int = 1
    outside: Bool[np.ndarray, "ny nx"] | None = None

    @classmethod
    def over(
        cls, lower: np.ndarray, upper: np.ndarray, robots: int, cell: float = 1.0, outside: np.ndarray | None = None
    ) -> "Explored":
        """Nothing seen yet; cells `outside` (ny, nx) the field need not be: they count as seen from the start."""
        nx, ny = (int(np.ceil((upper[k] - lower[k]) / cell - 1e-9)) for k in (0, 1))
        shape = (robots, ny, nx)
        none = np.zeros(shape, dtype=bool)
        fused = np.zeros((ny, nx), dtype=bool) if outside is None else outside.copy()
        return cls(np.asarray(lower, float), cell, fused, none, none.copy(), outside=outside)

    @property
    def raster(self) -> Raster:
        """Where the cells lie."""
        return Raster(self.lower, self.cell)

    def team(self) -> Bool[np.ndarray, "ny nx"]:
        """What the whole team knows to be seen."""
        return np.asarray(self.fused | self.pending.any(axis=0))

    def known_to(self, j: int) -> Bool[np.ndarray, "ny nx"]:
        """What robot j knows to be seen: the team's cells and its own that were not delivered yet."""
        return np.asarray(self.team() | self.backlog[j])

    def seen_share(self) -> float:
        """What share of the field the team has seen."""
        if self.outside is None:
            return float(self.team().mean())
        return float(self.team()[~self.outside].mean())

    def sees(self, j: int, point: Float[np.ndarray, "2"]) -> bool:
        """Whether robot j knows the cell around `point` [m] to be seen."""
        ix, iy = ((point - self.lower) / self.cell).astype(int)
        ny, nx = self.fused.shape
        iy, ix = min(max(int(iy), 0), ny - 1), min(max(int(ix), 0), nx - 1)
        return bool(self.fused[iy, ix] or self.pending[:, iy, ix].any() or self.backlog[j, iy, ix])

    def deliver(self, j: int) -> None:
        """Robot j's message came through: its backlog is the team's knowledge."""
        self.pending[j] |= self.backlog[j]
        self.backlog[j] = False

    def fuse(self, j: int) -> None:
        """Robot j's submap is in the global map: its cells are safe."""
        self.fused |= self.pending[j] | self.backlog[j]
        self.pending[j] = False
        self.backlog[j] = False

    def lose(self, j: int) -> None:
        """Robot j died with its submap: cells only it had seen are unexplored again."""
        self.pending[j] = False
        self.backlog[j] = False

    def again(self) -> None:
        """Everything counts as unexplored: something was missed, look once more."""
        for cells in (self.fused, self.pending, self.backlog):
            cells[:] = False
        if self.outside is not None:
            self.fused |= self.outside
        self.sweeps += 1

    def add(self, other: "Explored") -> None:
        """What another crew has seen of the same raster is known here too."""
        self.fused |= other.fused
        self.pending |= other.pending
        self.backlog |= other.backlog

    def joined(self, other: "Explored", T: Float[np.ndarray, "3"]) -> "Explored":
        """What this crew and another one know together. T: `T_self_other`, of the other's raster in this one."""
        ny, nx = self.fused.shape
        centres = self.centres(np.argwhere(np.ones((ny, nx), dtype=bool)))
        at = np.floor((se2.act(se2.inverse(T), centres) - other.lower) / other.cell).astype(np.int64)
        inside = np.all((at >= 0) & (at < other.fused.shape[::-1]), axis=1)
        x, y = np.where(inside[:, None], at, 0).T

        def seen(cells: np.ndarray) -> np.ndarray:
            return np.asarray((cells[..., y, x] & inside).reshape(*cells.shape[:-2], ny, nx))

        pending, backlog = (
            np.concatenate([mine, seen(its)])
            for mine, its in ((self.pending, other.pending), (self.backlog, other.backlog))
        )
        return replace(self, fused=self.fused | seen(other.fused), pending=pending, backlog=backlog)

    def centres(self, cells: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of `cells` given as rows (iy, ix)."""
        return self.lower + (cells[:, ::-1] + 0.5) * self.cell


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkBelief(TeamBelief):
    """explored: cells by who knows of them; submaps and the global map with their covariances; floor: what the plan of
    the walls tells, None in an open field; contacts: (k, 2) places in the map where a robot lately met a wall that it
    thought farther away; lower, upper: (2,) corners [m] of the field; away: (M,) robots beyond the radio's range, which
    are not alive here but may be at work: the plan made together holds for them.
    """

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    explored: Explored
    submaps: tuple[Submap, ...]
    global_map: GlobalMap
    floor: FloorPlan | None = None
    contacts: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    away: Bool[np.ndarray, " r"]


Planner = Callable[[LandmarkBelief, Float[np.ndarray, "r 3"], ExploreConfig], Float[np.ndarray, "r 2"]]


@dataclass(slots=True)
class Carried:
    """A robot that was carried away at `step`; back: the step when it was found in the map, None where it was not."""

    robot: str
    step: int
    back: int | None = None


class Handed(NamedTuple):
    """A submap as it was handed over; origin: landmark in it -> sightings of true landmarks; seen: those."""

    submap: Submap
    origin: dict[str, Counter[int]]
    seen: frozenset[int]


@dataclass(slots=True)
class MapTruth:
    """Which landmarks are in a map, and of which true landmark how many sightings of each of its estimates were.

    An estimate is of the landmark that most of its sightings were of: where two landmarks close together were exchanged
    after a first sighting, it comes to lie on the other one.
    """

    safe: set[int] = field(default_factory=set)
    sightings: dict[str, Counter[int]] = field(default_factory=dict)
    misassociations: int = 0

    @property
    def source(self) -> dict[str, int]:
        """Global landmark -> true landmark."""
        return {name: _mostly(sightings) for name, sightings in self.sightings.items()}

    def hand_over(self, origin: dict[str, Counter[int]], ids: tuple[str, ...], done: Handover) -> None:
        """What a submap's landmarks `ids` were of is told of the map's; matches that are wrong are counted.

        origin: submap landmark -> sightings. Wrong: a sighting of another landmark than most of its estimate's, and two
        estimates made one that were not.
        """
        for local, name in zip(ids, done.names, strict=True):
            sightings = origin.get(local)
            if not sightings:
                continue
            self.misassociations += sightings.total() - max(sightings.values())
            if name is not None:
                self._join(name, sightings)
        self._merge(done.merged)

    def meet(self, other: "MapTruth", renamed: dict[str, str], merged: tuple[tuple[str, str], ...]) -> None:
        """The other map, whose landmarks are called as `renamed` says, is part of this one; `merged`: kept, gone."""
        self.safe |= other.safe
        self.misassociations += other.misassociations
        for name, sightings in other.sightings.items():
            self._join(renamed[name], sightings)
        self._merge(merged)

    def _merge(self, merged: tuple[tuple[str, str], ...]) -> None:
        for kept, gone in merged:
            if gone in self.sightings:
                self._join(kept, self.sightings.pop(gone))

    def _join(self, name: str, sightings: Counter[int]) -> None:
        known = self.sightings.setdefault(name, Counter())
        self.misassociations += bool(known) and _mostly(known) != _mostly(sightings)
        known.update(sightings)


@dataclass(slots=True, eq=False)
class LandmarkCrew:
    """Robots that have one map and plan together.

    robots: those whose frames that map, G, holds, in its order; present: which of them have it, the others being beyond
    the radio's range or dead; lower, upper: (2,) corners [m] in G of the field as they know it; handed: the submaps
    that G was made of, where a radio of limited range makes that worth keeping; memory: their planner's; truth: whose
    landmarks those of G are; waited: steps at the rendezvous; complete: the step when all robots last had this map.
    """

    robots: Int[np.ndarray, " k"]
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    start: GlobalMap
    explored: Explored
    present: Bool[np.ndarray, " k"]
    G: GlobalMap = field(init=False)
    handed: dict[tuple[int, int], Handed] = field(default_factory=dict)
    memory: dict[str, Any] = field(default_factory=dict)
    truth: MapTruth = field(default_factory=MapTruth)
    waited: int = 0
    complete: int = 0

    def __post_init__(self) -> None:
        self.G = self.start

    @property
    def members(self) -> Int[np.ndarray, " m"]:
        """The robots that have this map."""
        return np.asarray(self.robots[self.present])

    def at(self, j: int) -> int:
        """Which of the crew's robots robot j is."""
        return int(np.flatnonzero(self.robots == j)[0])

    def leave(self, gone: list[int]) -> None:
        """Robots that have another map now are none of this one's any more; what they saw for it stays."""
        keep = ~np.isin(self.robots, gone)
        self.G = without_frames(self.G, [k for k, kept in enumerate(keep) if not kept])
        ex = self.explored
        ex.fused |= ex.pending[~keep].any(axis=0)
        ex.pending, ex.backlog = ex.pending[keep], ex.backlog[keep]
        self.robots, self.present = self.robots[keep], self.present[keep]

    def hand_over(self, step: int, j: int, handed: Handed, pairing: PairingConfig | None, *, keep: bool) -> None:
        """Robot j's submap joins the map. pairing: None where identities are known; keep: for meetings to come."""
        if keep:
            self.handed[step, j] = handed
        cfg = pairing or PairingConfig()
        done = hand_over(self.G, handed.submap, known=pairing is None, prefix="m", cfg=cfg)
        self.truth.hand_over(handed.origin, handed.submap.ids, done)
        self.truth.safe |= handed.seen
        self.G = done.map


def parted(crew: LandmarkCrew, present: Bool[np.ndarray, " k"]) -> LandmarkCrew:
    """What those `present` of a crew take with them: all it knows, and the plan it made."""
    out = LandmarkCrew(crew.robots, crew.lower, crew.upper, crew.start, deepcopy(crew.explored), present)
    out.G, out.handed, out.truth = crew.G, dict(crew.handed), deepcopy(crew.truth)
    out.memory, out.complete = deepcopy(crew.memory), crew.complete
    return out


def united(
    crews: Sequence[LandmarkCrew], present: Bool[np.ndarray, " k"], pairing: PairingConfig | None
) -> LandmarkCrew:
    """What those `present`, of several crews, know together; the planner begins anew."""
    first = max(crews, key=lambda crew: len(crew.handed))
    out = parted(first, present)
    out.memory, out.complete = {}, max(crew.complete for crew in crews)
    for crew in crews:
        out.explored.add(crew.explored)
    if all(key in out.handed for crew in crews for key in crew.handed):
        return out
    together = {key: handed for crew in crews for key, handed in crew.handed.items()}
    out.G, out.truth, out.handed = first.start, MapTruth(), {}
    for step, j in sorted(together):
        out.hand_over(step, j, together[step, j], pairing, keep=True)
    return out


def _mostly(sightings: Counter[int]) -> int:
    """The landmark that most sightings were of, of several the one seen first."""
    return max(sightings, key=sightings.__getitem__)
