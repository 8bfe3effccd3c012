"""A finished map as something to score poses against, and whether a place found in it is to be believed.

Every cell of the field knows its nearest occupied cell. What speaks for a place is what the map explains, what light
says, and what else would fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from ..core import se2
from ..core.config import config
from ..core.records import frozen
from ..core.rows import spread
from ..kernels.laser.scan_laying import score_field
from .beam import Beams
from .laser_map import GridMap
from .place_search import Hit, LikelihoodField, everywhere, likelihood_field, query_around, search

MARGIN = 10  # cells round the map in which a beam still finds its nearest


@dataclass(frozen=True, slots=True)
class NearestField:
    """near: (rows, cols, 3), mean point [m] and feature of the nearest occupied cell; origin, cell: as in GridMap."""

    near: Float[np.ndarray, "rows cols 3"]
    origin: Float[np.ndarray, "2"]
    cell: float

    def nearest(self, points: Float[np.ndarray, "n 2"], outside: float) -> Float[np.ndarray, "n 3"]:
        """The nearest wall point of each point and its feature; `outside` [m] away for points beyond the table."""
        at = np.floor((points - self.origin) / self.cell).astype(int)
        rows, cols = self.near.shape[:2]
        inside = (at[:, 0] >= 0) & (at[:, 0] < cols) & (at[:, 1] >= 0) & (at[:, 1] < rows)
        out = np.column_stack([points + outside, np.zeros(len(points))])
        out[inside] = self.near[at[inside, 1], at[inside, 0]]
        return out

    def score(
        self,
        poses: Float[np.ndarray, "p 3"],
        points: Float[np.ndarray, "n 3"],
        *,
        alpha: float,
        cap: float,
        matched_under: float = 0.0,
    ) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Mean of `min(D, cap)` [m^2] over the beams, and how many beams have a D below `matched_under`, a pose."""
        return score_field(
            self.near,
            self.origin,
            self.cell,
            np.ascontiguousarray(poses, dtype=float),
            np.ascontiguousarray(points, dtype=float),
            alpha,
            cap,
            matched_under,
        )


def wall_cells(grid: GridMap, least_occupancy: float) -> Bool[np.ndarray, "rows cols"]:
    """The cells of `grid` that are walls: occupied with a probability above `least_occupancy`."""
    return np.asarray((grid.weight > 0) & (grid.occupancy() > least_occupancy))


def nearest_field(grid: GridMap, least_occupancy: float) -> NearestField:
    """The table of the walls of `grid`. Raises ValueError when no cell of it is occupied."""
    there = wall_cells(grid, least_occupancy)
    if not there.any():
        raise ValueError("no cell of the map is occupied")
    there = np.pad(there, MARGIN)
    index = distance_transform_edt(~there, return_distances=False, return_indices=True)
    held = np.concatenate([grid.mean, grid.feature[..., None]], axis=-1).astype(float)
    held = np.pad(held, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)))
    near = held[index[0], index[1]]
    return NearestField(frozen(near), frozen(grid.origin - MARGIN * grid.resolution), grid.resolution)


LEAST_OCCUPANCY = 0.3  # of a cell that is a wall: what was mostly seen through was somebody passing by
TRUST_NEAR = 0.15  # [m] of a wall of the map within which a return lies on it
MOST_THROUGH = 0.1  # share of the beams at most that pass a wall of the map
TRUST_MARGIN = 0.4  # [m] or more before its return a beam must pass a wall to go through it
TRUST_LEAST_COSINE = 0.3  # of incidence: beams along walls do not say what they pass
TRUST_CONTRAST = 0.08  # [q] sd of the light of returns and of the map from which on it tells places apart: then
LEAST_LIGHT = 0.75  # both must correlate so much at least: by chance a place searched for reaches 0.71
LIGHT_AHEAD = 0.25  # correlation by which the place found must be ahead of another that fits, or
MOST_RATIO = 0.9  # share of its score that the next best place may have at most
TRUST_SAME = 0.5  # [m] and
SAME_TURN = 0.25  # [rad] between poses that are one place
TRUST_KEYFRAME = 0.3  # [m] between the scans another place is searched for with
TRUST_KEYFRAMES = 100  # scans that another place is searched for with, at most, the last
TRUST_SCANS = 200  # that are held against the map, spread over the trajectory
TRUST_BEAMS = 120  # returns of each that are asked

NOWHERE = 1e6  # [m] to the nearest wall from outside the map


@config
class TrustConfig:
    """When a robot that seems to be placed in a map is believed to be there."""

    least_explained: float = 0.6  # share of the returns that must lie on walls of the map, within


class LocalisedScan(NamedTuple):
    """A scan where the robot is believed to have made it. pose: (3,) in the map; eye: (2,) the scanner on the robot."""

    pose: Float[np.ndarray, "3"]
    beams: Beams
    eye: Float[np.ndarray, "2"]


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for and against a place.

    explained: share of the returns on walls of the map; through: share of the beams that pass one; light: correlation
    of brightness, None where it says nothing; rival: (3,) where the latest pose would lie at the next best place, None
    where there is none; ratio: that place's score over that of the place found (over 1: it fits better); doubt: why the
    place is not believed, empty where it is.
    """

    explained: float
    through: float
    light: float | None
    ratio: float
    rival: Float[np.ndarray, "3"] | None
    doubt: str


def evidence(
    seen: Sequence[LocalisedScan], grid: GridMap, walls: NearestField, *, light: bool, searched: bool, cfg: TrustConfig
) -> Evidence:
    """What scans, one at least, say of the poses they are believed to be made from.

    walls: of `grid`; light: whether brightness takes part; searched: whether the place was searched everywhere, so that
    another that fits as well is a reason for doubt.
    """
    some = [seen[k] for k in spread(len(seen), TRUST_SCANS)]
    here = _agreement(some, walls, np.zeros(3), light=light)
    ratio, rival = _rival(seen, grid, light=light) if searched else (0.0, None)
    doubt = _doubt(here, cfg)
    if not doubt and rival is not None and ratio > MOST_RATIO:
        shift = se2.compose(rival, se2.inverse(seen[-1].pose))
        there = _agreement(some, walls, shift, light=light)
        ahead = 0.0 if here.light is None or there.light is None else here.light - there.light
        if ahead < LIGHT_AHEAD:
            x, y, turn = rival
            place = f"({x:.1f} m, {y:.1f} m, {np.degrees(turn):.0f} degrees)"
            doubt = f"the scans fit also where the last pose is {place}: {ratio:.2f} times as well"
    return Evidence(here.explained, here.through, here.light, ratio, rival, doubt)


class _Agreement(NamedTuple):
    explained: float
    through: float
    light: float | None


def _doubt(here: _Agreement, cfg: TrustConfig) -> str:
    doubts = (
        (here.explained < cfg.least_explained, f"the map explains {100 * here.explained:.0f} % of the returns"),
        (here.through > MOST_THROUGH, f"{100 * here.through:.0f} % of the beams pass through walls of the map"),
        (
            here.light is not None and here.light < LEAST_LIGHT,
            f"the light sent back is not that of the map (correlation {here.light or 0.0:.2f})",
        ),
    )
    return next((reason for doubtful, reason in doubts if doubtful), "")


def _agreement(
    seen: Sequence[LocalisedScan], walls: NearestField, shift: Float[np.ndarray, "3"], *, light: bool
) -> _Agreement:
    """How the scans agree with the map when all their poses are moved rigidly."""
    far: list[np.ndarray] = []
    passed: list[np.ndarray] = []
    measured: list[np.ndarray] = []
    known: list[np.ndarray] = []
    for one in seen:
        b, pose = one.beams, se2.compose(shift, one.pose)
        pick = spread(len(b.q), TRUST_BEAMS)
        points = se2.act(pose, b.s[pick])
        near = walls.nearest(points, NOWHERE)
        d = np.hypot(*(near[:, :2] - points).T)
        far.append(d)
        steep = (b.c[pick] >= TRUST_LEAST_COSINE) & (b.r[pick] > 2.0 * TRUST_MARGIN)
        passed.append(_through(walls, se2.act(pose, one.eye), points[steep]))
        measured.append(b.q[pick][d < TRUST_NEAR])
        known.append(near[d < TRUST_NEAR, 2])
    every, through = np.concatenate(far), np.concatenate(passed)
    return _Agreement(
        float(np.mean(every < TRUST_NEAR)) if len(every) else 0.0,
        float(through.mean()) if len(through) else 0.0,
        _correlation(np.concatenate(measured), np.concatenate(known), TRUST_CONTRAST) if light else None,
    )


def _correlation(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], contrast: float) -> float | None:
    """Of two brightnesses; None where either hardly changes, which tells nothing."""
    if len(a) < 2 or a.std() < contrast or b.std() < contrast:
        return None
    return float(np.mean((a - a.mean()) * (b - b.mean())) / (a.std() * b.std()))


def _through(
    walls: NearestField, eye: Float[np.ndarray, "2"], points: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Which beams from `eye` pass a wall `margin` or more before they return, and after they left."""
    if not len(points):
        return np.zeros(0, bool)
    r = np.hypot(*(points - eye).T)
    s = np.arange(TRUST_MARGIN, float(r.max()) - TRUST_MARGIN, 0.5 * walls.cell)
    samples = eye + s[None, :, None] * ((points - eye) / r[:, None])[:, None]
    near = walls.nearest(samples.reshape(-1, 2), NOWHERE).reshape(len(points), len(s), 3)
    d = np.hypot(*(near[..., :2] - samples).transpose(2, 0, 1))
    return np.asarray(((d < 0.5 * walls.cell) & (s < r[:, None] - TRUST_MARGIN)).any(axis=1))


def _rival(seen: Sequence[LocalisedScan], grid: GridMap, *, light: bool) -> tuple[float, Float[np.ndarray, "3"] | None]:
    """The best other place of the last scans, laid together as they are believed to lie, and its score's ratio."""
    kept = [seen[-1]]
    for one in reversed(seen[:-1]):
        if np.hypot(*(one.pose - kept[-1].pose)[:2]) >= TRUST_KEYFRAME:
            kept.append(one)
    kept = kept[:TRUST_KEYFRAMES]
    lights = [one.beams.q for one in kept] if light else None
    clouds = [one.beams.s for one in kept]
    query = query_around(np.array([one.pose for one in kept]), clouds, 0, len(kept), lights)
    if not len(query.points):
        return 1.0, None
    field = _field(grid, light=light)
    least = 0.5 * MOST_RATIO
    places = search(field, query.points, everywhere(field), query.q, least_ratio=least)
    hits = [hit for hit in (places.best, places.second) if hit is not None]
    own = [hit for hit in hits if _same(hit, seen[-1].pose)]
    others = [hit for hit in hits if not _same(hit, seen[-1].pose)]
    if not others:
        return 0.0, None
    ratio = others[0].score / own[0].score if own else 1.0  # the place found is not even the second
    return ratio, np.array(others[0].pose)


def _field(grid: GridMap, *, light: bool) -> LikelihoodField:
    rows, cols = np.nonzero(wall_cells(grid, LEAST_OCCUPANCY))
    q = grid.feature[rows, cols].astype(float) if light else None
    return likelihood_field(grid.mean[rows, cols].astype(float), q)


def _same(hit: Hit, pose: Float[np.ndarray, "3"]) -> bool:
    d = se2.between(pose, hit.pose)
    return bool(np.hypot(d[0], d[1]) < TRUST_SAME and abs(d[2]) < SAME_TURN)
