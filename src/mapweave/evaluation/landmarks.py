"""Landmarks against a survey: one rigid alignment, errors, consistency, labels that look exchanged, growth."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import is_positive_definite
from ..core.names import in_order
from ..core.truth import Survey
from ..fusion.cluster import ENOUGH, average, clusters
from ..fusion.identities import match_maps
from ..landmarks.landmark_map import LandmarkMap
from .consistency import gauge_free_nees

BETTER = 0.9  # every exchange must take a tenth off the error
MUCH_BETTER = 0.5  # and the last of them halve it
WORTH_NAMING = 0.05  # [m] and take at least this off
RINGS = 200  # landmarks up to which rings of labels are looked for, by geometry alone
SURVEYED = 1e-3  # [m] how far a survey is trusted there


@dataclass(frozen=True, slots=True)
class Exchange:
    """Labels `a` and `b` swapped take the landmark error from `before` to `after` [m].

    Where the next one's `a` is this one's `b`, both are of one ring of labels, each of which stands for the next.
    """

    a: str
    b: str
    before: float
    after: float


def exchanges_told(exchanges: Sequence[Exchange]) -> list[str]:
    """A sentence for every pair or ring of labels."""
    rings: list[list[Exchange]] = []
    for e in exchanges:
        if rings and rings[-1][-1].b == e.a:
            rings[-1].append(e)
        else:
            rings.append([e])
    out = []
    for ring in rings:
        last = ring[-1]
        names = f"{', '.join(e.a for e in ring)} and {last.b}"
        how = "look exchanged" + (", each for the next" if len(ring) > 1 else "")
        out.append(f"{names} {how}: {ring[0].before:.2f} m -> {last.after:.2f} m")
    return out


@dataclass(frozen=True, slots=True)
class LandmarkScore:
    """rmse [m] over the n landmarks that have a survey, after `alignment` (`T_survey_map`); None where it is undefined.

    errors: (n, 2) [m] aligned map minus survey, in the survey's frame, in the order of `ids`.
    """

    ids: tuple[str, ...]
    unsurveyed: int
    rmse: float | None
    nees_per_dof: float | None
    dof: int | None
    alignment: Float[np.ndarray, "3"] | None
    errors: Float[np.ndarray, "n 2"]


def score_landmarks(landmarks: LandmarkMap, survey: Survey) -> LandmarkScore:
    """The score under one rigid transform fitted, unweighted, to the surveyed landmarks present in the map."""
    ours, true = _common(landmarks, survey)
    left = len(landmarks) - len(ours)
    if len(ours) < 2:
        return LandmarkScore(ours.ids, left, None, None, None, None, np.zeros((len(ours), 2)))
    T = se2.align(ours.mean, true)
    errors = se2.act(T, ours.mean) - true
    nees = gauge_free_nees(ours.mean, ours.cov, true)
    per_dof, dof = (None, None) if nees is None or nees[1] < 1 else (nees[0] / nees[1], nees[1])
    return LandmarkScore(ours.ids, left, _rms(errors), per_dof, dof, T, errors)


def rmse_after_alignment(landmarks: LandmarkMap, survey: Survey) -> float | None:
    """RMS error [m] of a map's surveyed landmarks after its own rigid alignment."""
    return score_landmarks(landmarks, survey).rmse


def find_exchanges(landmarks: LandmarkMap, survey: Survey) -> tuple[tuple[Exchange, ...], Survey]:
    """Labels that, swapped one pair after the other, explain a large error; and the survey with them swapped.

    Pairs of two that have nothing to do with each other, the best first, unless rings of more explain far more.
    """
    pairs = _pairs(landmarks, survey)
    left = pairs[-1].after if pairs else rmse_after_alignment(landmarks, survey) or 0.0
    rings = _rings(landmarks, survey) if left > WORTH_NAMING else ()
    found = rings if rings and rings[-1].after < MUCH_BETTER * left else pairs
    return found, _exchanged(survey, found)


def _pairs(landmarks: LandmarkMap, survey: Survey) -> tuple[Exchange, ...]:
    """Every pair is tried: swapping changes neither centroid, so with centred points a, b as complex numbers the best
    fit's error is |a|^2 + |b|^2 - 2 |sum conj(a) b|, and a swap changes that sum by one product.
    """
    ours, true = _common(landmarks, survey)
    n = len(ours)
    exchanges: list[Exchange] = []
    names = list(ours.ids)
    if n < 3:
        return ()
    a, b = _centred(ours.mean), _centred(true)
    taken = np.zeros(n, bool)
    for _ in range(n // 2):
        energy = float(np.sum(np.abs(a) ** 2) + np.sum(np.abs(b) ** 2))
        S = np.sum(np.conj(a) * b)
        swapped = np.abs(S - np.conj(a[:, None] - a[None, :]) * (b[:, None] - b[None, :]))
        swapped[taken] = swapped[:, taken] = -np.inf
        i, j = (int(k) for k in np.unravel_index(int(np.argmax(np.triu(swapped, 1))), swapped.shape))
        before = np.sqrt(max(0.0, energy - 2 * float(np.abs(S))) / n)
        after = np.sqrt(max(0.0, energy - 2 * float(swapped[i, j])) / n)
        if not after < BETTER * before:
            break
        exchanges.append(Exchange(names[i], names[j], float(before), float(after)))
        b[i], b[j] = b[j], b[i]
        taken[i] = taken[j] = True
    while exchanges and not (
        exchanges[-1].after < MUCH_BETTER * exchanges[-1].before and _gain(exchanges[-1]) > WORTH_NAMING
    ):
        exchanges.pop()
    return tuple(exchanges)


def _rings(landmarks: LandmarkMap, survey: Survey) -> tuple[Exchange, ...]:
    """Rings of labels each of which stands where the survey has the next, as places tell when names are left out."""
    ours, true = _common(landmarks, survey)
    if len(ours) > RINGS or not is_positive_definite(ours.cov):
        return ()
    match = match_maps(ours, LandmarkMap(ours.ids, true, SURVEYED**2 * np.eye(2 * len(ours))))
    if not match.accepted:
        return ()
    stands = {ours.ids[i]: ours.ids[j] for i, j in match.links if i != j}
    out: list[Exchange] = []
    mended = survey
    for first in sorted(stands, key=in_order):
        ring = [first]
        while (following := stands.pop(ring[-1], None)) not in {None, first}:
            ring.append(following)
        for a, b in pairwise(ring) if following == first else ():
            before = rmse_after_alignment(landmarks, mended) or 0.0
            mended = _exchanged(mended, [Exchange(a, b, before, before)])
            out.append(Exchange(a, b, before, rmse_after_alignment(landmarks, mended) or 0.0))
    return tuple(out)


def naive_mean(maps: Sequence[LandmarkMap]) -> LandmarkMap | None:
    """The equal-weight Procrustes mean: what one would do without covariances. Its covariance is the identity.

    Of the maps that hang together by two shared landmarks or more each; None where no map has two landmarks.
    """
    usable = [m for m in maps if len(m) >= ENOUGH]
    if not usable:
        return None
    largest = clusters(usable)[0]
    joined = average([usable[k] for k in largest.members], largest)
    return LandmarkMap(joined.ids, joined.mean, np.eye(2 * len(joined.ids)))


def _gain(exchange: Exchange) -> float:
    return exchange.before - exchange.after


def _common(landmarks: LandmarkMap, survey: Survey) -> tuple[LandmarkMap, Float[np.ndarray, "n 2"]]:
    where = {name: i for i, name in enumerate(survey.ids)}
    ids = [name for name in landmarks.ids if name in where]
    return landmarks.select(ids), survey.xy[[where[name] for name in ids]].reshape(-1, 2)


def _exchanged(survey: Survey, exchanges: Sequence[Exchange]) -> Survey:
    names = list(survey.ids)
    for e in exchanges:
        i, j = names.index(e.a), names.index(e.b)
        names[i], names[j] = names[j], names[i]
    return Survey(tuple(names), survey.xy)


def _centred(points: Float[np.ndarray, "n 2"]) -> np.ndarray:
    p = points - points.mean(0)
    return np.asarray(p[:, 0] + 1j * p[:, 1])


def _rms(errors: Float[np.ndarray, "n 2"]) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


@dataclass(frozen=True, slots=True)
class GrowthPoint:
    """The largest component after `t` [s] since the first row; robots: how many are tied in.

    trace [m^2] and log_det of the joint covariance; rmse [m] and nees_per_dof against a survey, None without one.
    """

    t: float
    robots: int
    landmarks: int
    trace: float | None
    log_det: float | None
    rmse: float | None = None
    nees_per_dof: float | None = None


def growth_point(t: float, robots: int, landmarks: LandmarkMap, survey: Survey) -> GrowthPoint:
    """What there is to say about the global map at `t`."""
    n = len(landmarks)
    score = score_landmarks(landmarks, survey)
    sign, log_det = np.linalg.slogdet(landmarks.cov) if n else (0.0, 0.0)
    return GrowthPoint(
        t=t,
        robots=robots,
        landmarks=n,
        trace=float(np.trace(landmarks.cov)) if n else None,
        log_det=float(log_det) if sign > 0 else None,
        rmse=score.rmse,
        nees_per_dof=score.nees_per_dof,
    )
