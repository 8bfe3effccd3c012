"""Places: where one submap lies in another, found without a guess.

A new submap is searched for every older one, of whatever robot: the directions that walls face tell the headings that
come into question, at each of them every shift is tried (exactly: by branch and bound), and what fits is laid onto the
walls point to line. Loops of one robot, robots of a team, sessions and kidnapped robots are all found so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.gaussian import symmetrise
from ..core.records import frozen
from ..kernels.laser.place_search import FULL, lay_onto_lines, stamp
from ..kernels.mapping.places import (
    Clouds,
    LitWalls,
    SearchedField,
    SearchRules,
    heading_peaks,
    light_along,
    search_submaps,
)
from ..laser.consistency import adjoint
from ..laser.place_search import Q_LEVELS, LikelihoodField, PlaceConfig, brightness, inliers, likelihood_field
from ..laser.scan_matching import BINS
from .submaps import PlaceSubmap

MOST_RATIO = 0.9  # of the score that another place may have
LAY_TURN = 0.06  # [rad] between the headings tried where it is known about how a submap lies
MOST_MOVED = 0.6  # [m] that may lie between where it was found and where it was laid

HEADINGS = 4  # tried of a pair, at most,
HEADINGS_APART = 8  # [bins] between them,
HEADING_SHARE = 0.3  # of the likeliest one's correlation at least
APART, APART_TURN = 1.0, 0.25  # [m], [rad] from the best: another place
GATES = (0.5, 0.4, 0.3, 0.2, 0.2, 0.15, 0.1)  # [m] widths of the robust cost as submaps are laid onto each other
LIT_MISFIT = 0.7  # where light takes part: what the best misses of a perfect score over what the next best misses
TEMPER = 0.1  # of the points count as independent
NOISE = 0.03  # [m] of a point on its line, at least
FLOOR, FLOOR_TURN = 0.02, 0.005  # [m], [rad] sd that no match is better than
LIT_STEP, LIT_CELL = 0.1, 0.1  # [m] between the shifts at which light is compared, and of the cells of its walls
LIT_NEAR = 0.15  # [m] a point this near is of the same piece of wall
LIT_POINTS = 100  # that are compared, at least
LIT_LEAST = 0.85  # correlation of light where a submap lies, at least, and
LIT_MARGIN = 0.1  # more of it than anywhere else
LIT_SD = 0.05  # [m] of where along its walls light puts a submap
ACROSS = 0.1  # [m] step and smoothing of how far walls of one direction lie to the side
FIELD = PlaceConfig(cell=0.2, sigma=0.2, q_weight=0.4, widths=GATES, gate=0.5, inlier=0.15)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSearchConfig:
    """What of a pair of submaps is looked at, and what is taken for one place until the graph decides."""

    reach: float = 12.0  # [m] between the anchors of two submaps of one place, at most
    least_heading: float = 0.35  # correlation of the directions of walls: less, and the pair is not looked at
    least_score: float = 0.55  # share of a perfect fit's likelihood
    least_share: float = 0.6  # of the points must lie on walls once laid onto them,
    least_held: float = 40.0  # points must hold the weakest direction, and


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """PlaceSubmap `first` found in submap `second`, numbers in a `PlaceIndex`; first < second.

    measured: (3,) pose of second's anchor in first's; covariance: (3, 3) of an error in second's frame; score, ratio:
    of the search, and the next best place's over it; share: of first's points on second's walls; held: (2,) points that
    hold the weakest direction and the one across it; weak: (2,) unit, the weakest in first's frame; clear: whether the
    two submaps leave no doubt; one that is not clear tells what else is possible.
    """

    first: int
    second: int
    measured: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    score: float
    ratio: float
    share: float
    held: tuple[float, float]
    weak: Float[np.ndarray, "2"]
    clear: bool = True

    @property
    def information(self) -> Float[np.ndarray, "3 3"]:
        return symmetrise(np.linalg.inv(self.covariance))

    def inverse(self) -> "PlaceMatch":
        """The same place with the two submaps changing parts; `share` stays that of the points that were laid."""
        A = adjoint(self.measured)
        return replace(
            self,
            first=self.second,
            second=self.first,
            measured=se2.inverse(self.measured),
            covariance=symmetrise(A @ self.covariance @ A.T),
            weak=se2.rotation(float(self.measured[2])).T @ self.weak,
        )


class PlaceIndex:
    """Submaps of any robots, each searched for in those that came later. `add` changes it."""

    def __init__(self, cfg: PlaceSearchConfig | None = None) -> None:
        self.cfg = cfg or PlaceSearchConfig()
        self.submaps: list[PlaceSubmap] = []
        self._points = np.zeros((0, 2))
        self._levels = np.zeros(0, np.int64)
        self._signature = np.zeros((0, BINS // 2 + 1), np.complex128)
        self._start = [0]

    def __len__(self) -> int:
        return len(self.submaps)

    def copy(self) -> "PlaceIndex":
        """The same index, which may grow without this one's knowing."""
        other = PlaceIndex(self.cfg)
        other.submaps, other._start = list(self.submaps), list(self._start)
        other._points, other._levels = np.array(self._points), np.array(self._levels)
        other._signature = np.array(self._signature)
        return other

    def select(self, keep: Sequence[int]) -> "PlaceIndex":
        """An index of these submaps alone, numbered in this order."""
        other = PlaceIndex(self.cfg)
        for k in keep:
            other.add(self.submaps[k])
        return other

    def add(self, new: PlaceSubmap) -> int:
        """The number of the submap, which later ones will be searched for."""
        points = new.points[new.thin]
        end = self._start[-1] + len(points)
        self._points = _room(self._points, end)
        self._levels = _room(self._levels, end)
        self._signature = _room(self._signature, len(self) + 1)
        self._points[self._start[-1] : end] = points
        self._levels[self._start[-1] : end] = 0 if new.q is None else brightness(new.q[new.thin])
        self._signature[len(self)] = new.signature
        self._start.append(end)
        self.submaps.append(new)
        return len(self) - 1

    def search(
        self, new: int, among: Sequence[int] | Int[np.ndarray, " k"], *, every: bool = False
    ) -> list[PlaceMatch]:
        """Which of the submaps `among` are the place of submap `new`, as far as the two of them tell.

        every: those that are not clear too, and the next best places.
        """
        among = np.asarray(among, np.int64)
        if not len(among):
            return []
        c, own = self.cfg, self.submaps[new]
        lit = own.q is not None and all(self.submaps[k].q is not None for k in among.tolist())
        place = likelihood_field(own.points, own.q if lit else None, FIELD)
        turns, count = heading_peaks(
            np.fft.irfft(own.signature[None] * np.conj(self._signature[among]), BINS),
            HEADINGS,
            HEADINGS_APART,
            HEADING_SHARE,
            c.least_heading,
        )
        asked = count > 0
        among, turns, count = among[asked], turns[asked], count[asked]
        rows, start = self._rows(among)
        clouds = Clouds(self._points[rows], self._levels[rows], start)
        found = _search(place, clouds, turns, count, int(c.reach / FIELD.cell), c.least_score)
        fits = []
        walls = _lit_walls(own.points, own.q) if lit and own.q is not None else None
        for j, (k, row) in enumerate(zip(among.tolist(), found, strict=True)):
            if row[3] > 0.0:
                fit = self._fit(place, k, new, row, c)
                lies = None
                if walls is not None and fit.held[0] < c.least_held:
                    lies = self._by_light(walls, k, fit.weak, turns[j, : count[j]])
                fits.append(fit if lies is None else self._fit(place, k, new, row, c, lies))
            if every and row[7] > 0.0:
                fits.append(replace(self._fit(place, k, new, row[[4, 5, 6, 7, 0, 1, 2, 3]], c), clear=False))
        return [fit for fit in fits if fit.clear or every]

    def lay(
        self, new: int, old: int, pose: Float[np.ndarray, "3"], reach: Float[np.ndarray, "3"], rules: PlaceSearchConfig
    ) -> PlaceMatch | None:
        """Submap `old` in submap `new` [m, m, rad] within `reach` of `pose`; None where it fits nowhere there.

        Clear where `rules` hold and it fits nowhere else there about as well.
        """
        own = self.submaps[new]
        place = likelihood_field(own.points, None, FIELD)
        points = np.asarray(se2.act(pose, self._points[self._start[old] : self._start[old + 1]]))
        half = int(np.ceil(reach[2] / LAY_TURN))
        turns = LAY_TURN * np.arange(-half, half + 1.0)[None]
        clouds = Clouds(points, self._levels[self._start[old] : self._start[old + 1]], np.array([0, len(points)]))
        cells = int(np.ceil(max(reach[:2]) / FIELD.cell))
        row = _search(place, clouds, turns, np.array([turns.shape[1]]), cells, rules.least_score)[0]
        if row[3] <= 0.0:
            return None
        row[:3] = se2.compose(row[:3], pose)
        return self._fit(place, old, new, row, rules)

    def _rows(self, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rows of the points of the submaps `among`, and where those of each begin."""
        first = np.asarray(self._start, np.int64)[among]
        size = np.asarray(self._start, np.int64)[among + 1] - first
        start = np.concatenate([[0], np.cumsum(size)])
        return np.repeat(first - start[:-1], size) + np.arange(start[-1]), start

    def _by_light(
        self, walls: LitWalls, k: int, weak: Float[np.ndarray, "2"], turns: Float[np.ndarray, " t"]
    ) -> tuple[Float[np.ndarray, "3"], float] | None:
        """Where submap `k`, whose walls all run along `weak` in its frame, lies by its light, and how much less likely
        light finds the next best place; None where light does not tell.
        """
        old = self.submaps[k]
        q = np.zeros(0) if old.q is None else old.q[old.thin]
        shifts = np.arange(-self.cfg.reach, self.cfg.reach + LIT_STEP / 2, LIT_STEP)
        rows, starts, ways = [], [], []
        for turn in turns.tolist():
            turned = old.points[old.thin] @ se2.rotation(turn).T
            along = se2.rotation(turn) @ weak
            side = np.array([-along[1], along[0]])
            start = _across(turned @ side, walls.points @ side) * side
            rows.append(light_along(turned + start, q, along, shifts, walls, LIT_NEAR, LIT_POINTS))
            starts.append(np.append(start, turn))
            ways.append(along)
        told = np.array(rows)
        h, s = np.unravel_index(int(np.argmax(told)), told.shape)
        rest = np.array(told)
        rest[h, np.abs(shifts - shifts[s]) < APART] = -1.0
        best, second = float(told[h, s]), max(0.0, float(rest.max()))
        if best < LIT_LEAST or best < second + LIT_MARGIN or s in {0, len(shifts) - 1}:
            return None
        before, after = told[h, s - 1], told[h, s + 1]
        bend = before - 2.0 * best + after
        shift = shifts[s] + (LIT_STEP * np.clip(0.5 * (before - after) / bend, -0.5, 0.5) if bend < 0.0 else 0.0)
        return starts[h] + np.append(shift * ways[h], 0.0), second / best

    def _fit(
        self,
        place: LikelihoodField,
        k: int,
        new: int,
        row: np.ndarray,
        c: PlaceSearchConfig,
        lies: tuple[Float[np.ndarray, "3"], float] | None = None,
    ) -> PlaceMatch:
        """A place that was found, laid onto the walls. row: of `search_submaps`; lies: where light puts it instead."""
        points, lit = self.submaps[k].points, place.q is not None
        start = frozen(row[:3] if lies is None else lies[0])
        pose, H, _, mean2 = lay_onto_lines(
            points,
            start,
            place.points,
            place.lines,
            place.nearest,
            place.origin,
            FIELD.cell,
            FIELD.gate,
            np.asarray(GATES),
            1e-5,
        )
        pose[2] = se2.wrap_angle(pose[2])
        values, vectors = np.linalg.eigh(H[:2, :2] - np.outer(H[:2, 2], H[2, :2]) / max(H[2, 2], 1e-12))
        if lies is not None:  # walls say nothing of where along them it lies
            along = se2.rotation(float(pose[2])) @ vectors[:, 0]
            pose[:2] += along * (along @ (start[:2] - pose[:2]))
        share = float(inliers(place, points, pose).mean())
        moved = float(np.hypot(*(pose[:2] - start[:2])))
        score, second = float(row[3]), float(row[7] if lies is None else lies[1] * row[3])
        alone = lies is not None or second <= MOST_RATIO * score or (lit and 1.0 - score <= LIT_MISFIT * (1.0 - second))
        held = lies is not None or values[0] >= c.least_held
        information = TEMPER * H / max(NOISE**2, mean2) + np.diag([0.1, 0.1, 1.0])
        covariance = symmetrise(np.linalg.inv(information)) + np.diag(np.square([FLOOR, FLOOR, FLOOR_TURN]))
        if lies is not None:
            covariance[:2, :2] += LIT_SD**2 * np.outer(vectors[:, 0], vectors[:, 0])
        A = adjoint(pose)
        return PlaceMatch(
            first=k,
            second=new,
            measured=se2.inverse(pose),
            covariance=symmetrise(A @ covariance @ A.T),
            score=score,
            ratio=second / score,
            share=share,
            held=(max(float(values[0]), 0.0), float(values[1])),
            weak=vectors[:, 0],
            clear=bool(alone and held and share >= c.least_share and moved <= MOST_MOVED),
        )


def _lit_walls(points: Float[np.ndarray, "n 2"], q: Float[np.ndarray, " n"]) -> LitWalls:
    """Walls whose light is compared."""
    margin = 2.0 * LIT_CELL
    low = points.min(axis=0) - margin
    cols, rows = np.ceil((points.max(axis=0) + margin - low) / LIT_CELL).astype(int).tolist()
    _, nearest = stamp(points, low, LIT_CELL, rows, cols, LIT_NEAR, 2)
    return LitWalls(points, q, nearest, low, LIT_CELL)


def _across(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " m"]) -> float:
    """[m] by which walls that lie at `a` to the side have to move to lie at `b`."""
    low = min(float(a.min()), float(b.min()))
    bins = int((max(float(a.max()), float(b.max())) - low) / ACROSS) + 2
    one, other = (
        np.convolve(np.bincount(((x - low) / ACROSS).astype(np.int64), minlength=bins), (0.25, 0.5, 0.25))
        for x in (a, b)
    )
    return ACROSS * (int(np.argmax(np.correlate(other, one, "full"))) - len(one) + 1)


_DIFFERENCE = FIELD.q_weight * np.arange(256) / (Q_LEVELS * FIELD.sigma)
LIGHT = np.floor(FULL * np.exp(-0.5 * np.square(_DIFFERENCE)) + 0.5).astype(np.int64)
"""What a difference of so many levels of brightness leaves of a point."""


def _search(
    place: LikelihoodField,
    clouds: Clouds,
    turns: Float[np.ndarray, "k t"],
    count: Int[np.ndarray, " k"],
    reach: int,
    least: float,
) -> Float[np.ndarray, "k 8"]:
    """`search_submaps` of the field, with room for shifts up to `reach` [cells] behind each row of its blocks."""
    size = 2**place.cfg.levels
    blocks = np.pad(place.blocks, ((0, 0), (0, 0), (0, 0), (0, (2 * reach + size) // size)))
    wide = blocks.shape[3]
    field = SearchedField(
        place.tables, blocks.reshape(size, size, -1), wide, place.dark, place.bright, LIGHT, place.origin, FIELD.cell
    )
    asked_for = SearchRules(reach, least, round(APART / FIELD.cell), APART_TURN)
    return np.asarray(search_submaps(field, clouds, turns, count, asked_for))


def _room(rows: np.ndarray, count: int) -> np.ndarray:
    """The rows with room for `count` of them: when it is too small, twice as much."""
    if count <= len(rows):
        return rows
    more = np.zeros((max(count, 2 * len(rows), 64), *rows.shape[1:]), rows.dtype)
    more[: len(rows)] = rows
    return more
