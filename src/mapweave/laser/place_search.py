"""Where a scan fits in a known place, whatever was believed before: exhaustive search in a window, then refinement.

[Hess16] section V-B: branch and bound on max-pooled likelihood fields; here with whole-number scores, so that the
answer is that of trying every pose of the window, and with received intensity as a second channel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core import se2
from ..core.errors import DataError, EstimateError
from ..core.gaussian import symmetrise
from ..core.records import freeze, frozen, owned
from ..core.rows import spread
from ..kernels.laser.place_search import (
    COARSE,
    FULL,
    MOST_POINTS,
    Brightness,
    branch_and_bound,
    fit_normals,
    lay_onto_lines,
    root_bounds,
    stamp,
    turned_cells,
)

Q_LEVELS = 200.0  # levels of brightness a unit of q
LARGEST = 40_000_000  # cells of a field
PLACE_APART = 0.7  # [m] from the best pose from which on another is of a second place, or
PLACE_APART_TURN = 0.25  # [rad]
PLACE_NOISE = 0.02  # [m] of a matched point, at least
LINE_REACH = 0.2  # [m] points this near make a wall's line
PLACE_TEMPER = 0.1  # of the points that count as independent
PLACE_FLOOR = (0.02, 0.02, 0.00523598775598299)  # [m, m, rad], 0.3 degrees: sd that no match is better than


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceConfig:
    """How places are searched. A field's value at distance d [m] and difference dq is
    `exp(-(d^2 + (q_weight dq)^2) / 2 sigma^2)`.
    """

    cell: float = 0.1  # [m] of the likelihood field, and step of the search
    sigma: float = 0.1  # [m] width of the field
    q_weight: float = 0.2  # [m] a unit of q counts as much as
    turn: float = 0.02617993877991494  # [rad] step of the search, 1.5 degrees
    levels: int = 2  # the coarsest squares are 2^levels cells wide
    gate: float = 0.3  # [m] a point farther from every wall is no match
    inlier: float = 0.1  # [m] and one this near is an inlier
    widths: tuple[float, ...] = (0.2, 0.2, 0.1, 0.1, 0.05)  # [m] of the refinement's robust cost


@dataclass(frozen=True, slots=True)
class LikelihoodField:
    """A place as walls to lay scans on, in the place's own frame.

    points: (n, 2) wall points [m]; q: (n,) brightness or None; lines: (n, 3) unit normal and width; tables, dark,
    bright, blocks: max-pooled likelihood, least and greatest brightness, as the kernels want them (dark, bright without
    cells when there is no brightness); nearest: (rows, cols) wall point of each cell or -1; origin: (2,) [m] of the
    lower corner.
    """

    points: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"] | None
    lines: Float[np.ndarray, "n 3"]
    tables: UInt8[np.ndarray, "levels r c"]
    dark: UInt8[np.ndarray, "levels r2 c2"]
    bright: UInt8[np.ndarray, "levels r2 c2"]
    blocks: UInt8[np.ndarray, "size size y x"]
    nearest: Int[np.ndarray, "rows cols"]
    origin: Float[np.ndarray, "2"]
    cfg: PlaceConfig


@dataclass(frozen=True, slots=True)
class Window:
    """The poses searched: centre + multiples of the steps up to `reach` [m] in x and y and `turn` [rad] in heading.

    A `turn` of pi or more is the full circle.
    """

    centre: Float[np.ndarray, "3"]
    reach: tuple[float, float]
    turn: float

    def __post_init__(self) -> None:
        freeze(self, "centre")


@dataclass(frozen=True, slots=True)
class Hit:
    """A pose of the scan in the place and its score, the mean likelihood of its points, 0 to 1."""

    pose: Float[np.ndarray, "3"]
    score: float


@dataclass(frozen=True, slots=True)
class PlacesFound:
    """best: where the scan fits best; second: the best that is another place; None where nothing scores `least`."""

    best: Hit | None
    second: Hit | None

    @property
    def ratio(self) -> float:
        """Second's score over best's: 0 when there is no second place, 1 when there is no place at all."""
        if self.best is None:
            return 1.0
        return 0.0 if self.second is None else self.second.score / self.best.score


@dataclass(frozen=True, slots=True)
class Fit:
    """A scan laid onto the walls of a place.

    pose: (3,) in the place's frame; covariance: (3, 3) of an error in the scan's frame, floor included; matches: points
    within the gate of a wall; share: of the points that are inliers; rms: [m] of matched distances; held: (2,) [1/m^2]
    information on the position (heading given up), weakest first; weak: (2,) unit direction in the place's frame in
    which the position is held least.
    """

    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    matches: int
    share: float
    rms: float
    held: Float[np.ndarray, "2"]
    weak: Float[np.ndarray, "2"]

    @property
    def information(self) -> Float[np.ndarray, "3 3"]:
        return symmetrise(np.linalg.inv(self.covariance))


def likelihood_field(
    points: Float[np.ndarray, "n 2"], q: Float[np.ndarray, " n"] | None = None, cfg: PlaceConfig | None = None
) -> LikelihoodField:
    """The field of wall `points` [m]. Raises DataError when they are none, not finite or too far apart."""
    cfg = cfg or PlaceConfig()
    points = frozen(points)
    if not len(points):
        raise DataError("a place needs wall points, found none: no beam met anything (are the ranges in metres?)")
    if not np.isfinite(points).all() or (q is not None and not np.isfinite(q).all()):
        raise DataError("a place needs finite wall points, found others")
    reach = int(np.ceil(max(3.0 * cfg.sigma, cfg.gate) / cfg.cell))
    origin = np.floor(points.min(axis=0) / cfg.cell - reach) * cfg.cell
    size = np.ceil((points.max(axis=0) - origin) / cfg.cell).astype(int) + reach + 1
    if float(size[0]) * float(size[1]) > LARGEST:
        wide, high = size * cfg.cell
        raise DataError(f"a place of {wide:.0f} x {high:.0f} m is too large to search")
    field, nearest = stamp(points, origin, cfg.cell, int(size[1]), int(size[0]), cfg.sigma, reach)
    tables = _pooled(field, cfg.levels)
    dark = bright = np.zeros((cfg.levels + 1, 0, 0), np.uint8)
    if q is not None:
        level = brightness(q)[np.maximum(nearest, 0)]
        there = field > 0
        bright = _pooled(np.where(there, level, 0).astype(np.uint8), cfg.levels)
        dark = 255 - _pooled(np.where(there, 255 - level, 0).astype(np.uint8), cfg.levels)
    return LikelihoodField(
        points=points,
        q=None if q is None else frozen(q),
        lines=owned(fit_normals(points, LINE_REACH)),
        tables=owned(tables),
        blocks=owned(_blocks((tables[-1] >> 2) + ((tables[-1] & 3) > 0), 2**cfg.levels)),
        dark=owned(np.ascontiguousarray(dark)),
        bright=owned(np.ascontiguousarray(bright)),
        nearest=owned(nearest),
        origin=frozen(origin),
        cfg=cfg,
    )


def brightness(q: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, " n"]:
    """The levels, 256 in all, that stand for q; they reach to q = 1.275."""
    return np.clip(np.round(q * Q_LEVELS), 0, 255).astype(np.uint8)


def search(
    place: LikelihoodField,
    points: Float[np.ndarray, "n 2"],
    window: Window,
    q: Float[np.ndarray, " n"] | None = None,
    *,
    least: float = 0.0,
    least_ratio: float = 0.0,
) -> PlacesFound:
    """The best and the second-best place of `points` (n, 2) [m, the scan's frame] in `place`: of all in the window.

    Brightness counts when both the place and the scan have it. Nothing that scores under `least` is looked for, nor a
    second place under `least_ratio` of the best: the higher they are, the faster the search.
    """
    cfg, points = place.cfg, frozen(points)
    if not len(points):
        return PlacesFound(None, None)
    if len(points) > MOST_POINTS:
        raise DataError(f"a place is searched with at most {MOST_POINTS} points, found {len(points)}")
    turns = headings(window, cfg.turn)
    asked = _asked(place, points, q, window, turns)
    lowest = max(1, int(np.ceil(least * asked.most)))
    hits: list[Hit] = []
    barred = np.zeros(0, np.int64)
    most = int(asked.bounds.max(initial=0)) * asked.scale
    for _ in range(2):
        score, a, ox, oy = _best(place, asked, lowest, most, barred)
        if a < 0:
            break
        most = score
        x, y = window.centre[0] + ox * cfg.cell, window.centre[1] + oy * cfg.cell
        hits.append(Hit(frozen([x, y, se2.wrap_angle(turns[a])]), score / asked.most))
        near = np.abs(se2.wrap_angle(turns - turns[a])) <= PLACE_APART_TURN
        barred = np.concatenate([[a, ox, oy, int((PLACE_APART / cfg.cell) ** 2 + 1e-9)], near]).astype(np.int64)
        lowest = max(lowest, int(np.ceil(least_ratio * score)))
    return PlacesFound(hits[0] if hits else None, hits[1] if len(hits) > 1 else None)


class _Asked(NamedTuple):
    """A scan and a window as the kernels want them; most: the score of a scan that fits everywhere."""

    cells: np.ndarray
    q: np.ndarray
    light: np.ndarray
    dark: np.ndarray
    bright: np.ndarray
    high: np.ndarray
    tiles: np.ndarray
    bounds: np.ndarray  # of every square, flat, by geometry
    scale: int
    most: int


def _asked(
    place: LikelihoodField, points: np.ndarray, q: np.ndarray | None, window: Window, turns: np.ndarray
) -> _Asked:
    cfg, size = place.cfg, 2**place.cfg.levels
    featured = place.q is not None and q is not None
    none = owned(np.zeros((cfg.levels + 1, 0, 0), np.uint8))
    light = np.exp(-0.5 * (cfg.q_weight * np.arange(256) / (Q_LEVELS * cfg.sigma)) ** 2)
    cells = turned_cells(points, window.centre[:2], turns, place.origin, cfg.cell)
    high = np.floor(np.asarray(window.reach) / cfg.cell + 1e-9).astype(np.int64)
    tiles = (2 * high + size) // size
    blocks = np.pad(place.blocks, ((0, 0), (0, 0), (0, 0), (0, int(tiles[0]))))
    return _Asked(
        cells=cells,
        q=np.zeros(len(points), np.int64) if q is None else brightness(q).astype(np.int64),
        light=np.floor(FULL * light + 0.5).astype(np.int64),
        dark=place.dark if featured else none,
        bright=place.bright if featured else none,
        high=high,
        tiles=tiles,
        bounds=root_bounds(blocks.reshape(size, size, -1), blocks.shape[3], cells, -high, tiles).ravel(),
        scale=COARSE * (FULL if featured else 1),
        most=len(points) * 255 * (FULL if featured else 1),
    )


def _best(
    place: LikelihoodField, asked: _Asked, lowest: int, most: int, barred: np.ndarray
) -> tuple[int, int, int, int]:
    """(score, heading number, ox, oy) of the best pose not barred, heading -1 when none scores `lowest`.

    The squares that promise most are looked into first: once a pose beats all that the others promise, it is the best.
    most: no pose scores more.
    """
    promised = most
    while True:
        promised = max(lowest, int(0.9 * promised))
        roots = np.flatnonzero(asked.bounds >= -(-promised // asked.scale))
        bounds = asked.bounds[roots].astype(np.int64) * asked.scale
        order = np.argsort(-bounds, kind="stable")
        hit = branch_and_bound(
            place.tables,
            Brightness(asked.dark, asked.bright, asked.light, asked.q),
            asked.cells,
            -asked.high,
            asked.high,
            asked.tiles,
            roots[order],
            bounds[order],
            lowest,
            barred,
        )
        if promised == lowest or (hit[1] >= 0 and hit[0] >= promised):
            return hit
        lowest = max(lowest, hit[0])


def headings(window: Window, step: float) -> Float[np.ndarray, " a"]:
    """The headings of `window` [rad], ascending; of a full circle evenly spaced, no farther apart than `step`."""
    if window.turn >= np.pi:
        count = int(np.ceil(2.0 * np.pi / step - 1e-9))
        return np.asarray(window.centre[2] + 2.0 * np.pi / count * np.arange(count))
    half = int(np.floor(window.turn / step + 1e-9))
    return np.asarray(window.centre[2] + step * np.arange(-half, half + 1))


def everywhere(place: LikelihoodField) -> Window:
    """The window of every pose that stands inside the box round the walls of `place`."""
    lower, upper = place.points.min(axis=0), place.points.max(axis=0)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return Window(np.array([middle[0], middle[1], 0.0]), (float(half[0]), float(half[1])), np.pi)


def refine(place: LikelihoodField, points: Float[np.ndarray, "n 2"], start: Float[np.ndarray, "3"]) -> Fit:
    """`points` [m, the scan's frame] laid onto the walls' lines from pose `start` on."""
    cfg, points = place.cfg, frozen(points)
    pose, H, matches, mean2 = lay_onto_lines(
        points,
        frozen(start),
        place.points,
        place.lines,
        place.nearest,
        place.origin,
        cfg.cell,
        cfg.gate,
        np.asarray(cfg.widths, dtype=float),
        1e-5,
    )
    pose[2] = se2.wrap_angle(pose[2])
    information = PLACE_TEMPER * H / max(PLACE_NOISE**2, mean2)
    P = np.linalg.inv(information + np.diag([1.0 / 3.0**2, 1.0 / 3.0**2, 1.0]))  # where no wall holds: 3 m, 1 rad
    P = symmetrise(P) + np.diag([sd**2 for sd in PLACE_FLOOR])
    position = information[:2, :2] - np.outer(information[:2, 2], information[2, :2]) / max(information[2, 2], 1e-12)
    values, vectors = np.linalg.eigh(symmetrise(position))
    weak = se2.rotation(float(pose[2])) @ vectors[:, 0]
    near = inliers(place, points, pose)
    share = float(near.mean()) if len(points) else 0.0
    return Fit(pose, P, int(matches), share, float(np.sqrt(mean2)), np.maximum(values, 0.0), weak)


def inliers(place: LikelihoodField, points: Float[np.ndarray, "n 2"], pose: Float[np.ndarray, "3"]) -> np.ndarray:
    """(n,) bool: which points, seen from `pose`, lie within the inlier distance of a wall's line."""
    cfg = place.cfg
    in_map = se2.act(pose, points)
    at = np.floor((in_map - place.origin) / cfg.cell).astype(int)
    rows, cols = place.nearest.shape
    inside = (at[:, 0] >= 0) & (at[:, 0] < cols) & (at[:, 1] >= 0) & (at[:, 1] < rows)
    k = np.full(len(points), -1)
    k[inside] = place.nearest[at[inside, 1], at[inside, 0]]
    d = in_map - place.points[np.maximum(k, 0)]
    n = place.lines[np.maximum(k, 0)]
    across = np.square((d * n[:, :2]).sum(axis=1))
    along = np.square(d).sum(axis=1) - across
    near = (across + n[:, 2] * along <= cfg.inlier**2) & (np.square(d).sum(axis=1) <= cfg.gate**2)
    return np.asarray((k >= 0) & near)


def _pooled(field: np.ndarray, levels: int) -> np.ndarray:
    """(levels + 1, rows + pad, cols + pad): the greatest of every square of 1, 2, 4 .. cells, from its low corner."""
    pad = 2**levels - 1
    out = np.zeros((levels + 1, field.shape[0] + pad, field.shape[1] + pad), field.dtype)
    out[0, pad:, pad:] = field
    for h in range(levels):
        below, step = out[h], 2**h
        wide = below.copy()
        np.maximum(wide[:, :-step], below[:, step:], out=wide[:, :-step])
        out[h + 1] = wide
        np.maximum(wide[:-step], wide[step:], out=out[h + 1][:-step])
    return out


def _blocks(table: np.ndarray, size: int) -> np.ndarray:
    """(size, size, Y, X): `table` filled up with zeros, its entries sorted by row and column modulo `size`."""
    rows, cols = (-(-n // size) * size for n in table.shape)
    whole = np.zeros((rows, cols), table.dtype)
    whole[: table.shape[0], : table.shape[1]] = table
    return np.ascontiguousarray(whole.reshape(rows // size, size, cols // size, size).transpose(1, 3, 0, 2))


MOST_VOXELS = 1 << 31  # along an axis, so that one number of 63 bits tells both
Cloud = Float[np.ndarray, "n 2"]
Clouds = Sequence[Float[np.ndarray, "_ 2"]]
Lights = Sequence[Float[np.ndarray, " _"]]


VOXEL = 0.15  # [m] a side: one point of a query is tried in each,
MOST = 400  # points, at most


@dataclass(frozen=True, slots=True)
class Query:
    """Points looked for in a place. points: (n, 2) [m] in the frame of keyframe `anchor`; q: (n,) or None."""

    anchor: int
    points: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"] | None


def query_around(
    poses: Float[np.ndarray, "n 3"], points: Clouds, anchor: int, around: int, q: Lights | None = None
) -> Query:
    """What keyframe `anchor` and the `around` before and after it saw, thinned evenly to the points a search takes."""
    members = range(max(0, anchor - around), min(len(poses) - 1, anchor + around) + 1)
    cloud, light = gathered(poses, points, members, poses[anchor], VOXEL, q)
    keep = spread(len(cloud), MOST)
    return Query(anchor, frozen(cloud[keep]), None if light is None else frozen(light[keep]))


def gathered(
    poses: Float[np.ndarray, "n 3"],
    points: Clouds,
    members: Sequence[int],
    frame: Float[np.ndarray, "3"],
    voxel: float,
    q: Lights | None = None,
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"] | None]:
    """The points of keyframes `members` seen from pose `frame`, and their q: the means of squares `voxel` [m] wide."""
    if not len(members):
        return np.zeros((0, 2)), None if q is None else np.zeros(0)
    seen = [se2.act(se2.between(frame, poses[k]), points[k]) for k in members]
    light = None if q is None else np.concatenate([q[k] for k in members])
    return voxelled(np.concatenate(seen), voxel, light)


def voxelled(
    points: Cloud, voxel: float, q: Float[np.ndarray, " n"] | None = None
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"] | None]:
    """One point, and one q, for every square of a grid that holds any: their mean. Ordered by row, then column.

    Raises EstimateError for points that lie farther out or apart than `MOST_VOXELS` of them.
    """
    if not len(points):
        return points, q
    low = points.min(axis=0)
    if not (np.ptp(points, axis=0) < MOST_VOXELS * voxel).all() or not (np.abs(low) < MOST_VOXELS * voxel).all():
        raise EstimateError(f"points from {low} to {points.max(axis=0)} m are no submap")
    at = np.floor(points / voxel).astype(np.int64)
    at -= at.min(axis=0)
    key = at[:, 1] * (int(at[:, 0].max()) + 1) + at[:, 0]
    _, which, count = np.unique(key, return_inverse=True, return_counts=True)
    mean = [np.bincount(which, points[:, k]) / count for k in range(2)]
    return np.column_stack(mean), None if q is None else np.bincount(which, q) / count
