"""Loop closures: a keyframe matched against an old place, and why the match is believed or not."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import mahalanobis2, symmetrise
from ..kernels.laser.local_map import count_matches
from .beam import Beams
from .keyframes import believed
from .scan_matching import BARE_TANGENT, FRONT_END_AGREE, FRONT_END_COARSE, FrontEnd, FrontEndConfig

CLOSURE_LEAST_SHARE = 0.5  # share of the returns that must match
CLOSURE_LEAST_MATCHES = 60  # returns that must match
CLOSURE_SEARCH_XY = 3.0  # [m] that the grid of starts reaches at most, and
CLOSURE_SEARCH_TURN = 0.3  # [rad] to either side
CLOSURE_SEARCH_BEAMS = 90  # returns of the scan that take part in the search, about

CLOSURE_LEAST_INFORMATION = 1.0  # [1/m^2] across the second weakest direction: less, and the place looks alike
CLOSURE_GATE = 16.27  # chi-square of the innovation, 3 degrees of freedom, 99.9 %
CLOSURE_SEARCH = 0.25  # [m] uncertainty of the relative place beyond which a grid of starts is searched
CLOSURE_MATCH_SD = 3.0  # [sd] by which the match may move the scan,
CLOSURE_MATCH_LEAST = np.array([0.3, 0.3, 0.1])  # [m, m, rad] at least
CLOSURE_SEARCH_SD = 2.5  # [sd] how far the grid of starts reaches
CLOSURE_SEARCH_STEPS = (0.3, 0.3, 0.04)  # [m, m, rad] between them
CLOSURE_SEARCH_REACH = 0.15  # [m] a return this near its line counts in the search
CLOSURE_TRUST = 1.0  # [-] what a match's information counts
CLOSURE_BLUR = 0.02  # [-] as for steps
CLOSURE_FLOOR = np.array([0.008, 0.008, 0.002])  # [m, m, rad] error of the old local map, which no match tells


@dataclass(frozen=True, slots=True)
class Closure:
    """Keyframe `second` of robot robots[1] matched against the place of keyframe `first` of robots[0].

    measured: (3,) pose of second in first; information: (3, 3) in second's frame; innovation: (3,) by which the match
    differs from the estimate, in second's frame; share: of the returns matched; nis: squared innovation in standard
    deviations (None when no match was made); reason: plain words; score, runner_up: of the best pose of a search and
    of the best one elsewhere, 0 to 1 (None without a search).
    """

    robots: tuple[int, int]
    first: int
    second: int
    accepted: bool
    reason: str
    measured: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    innovation: Float[np.ndarray, "3"]
    share: float
    nis: float | None
    score: float | None = None
    runner_up: float | None = None


class Place(NamedTuple):
    """An old keyframe's surroundings: scans and their poses in its frame."""

    scans: list[tuple[Beams, np.ndarray]]


class Matched(NamedTuple):
    """What a match says: accepted or not and why; the rest as in Closure."""

    accepted: bool
    reason: str
    measured: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    innovation: Float[np.ndarray, "3"]
    share: float
    nis: float | None
    score: float | None = None
    runner_up: float | None = None


class PlaceMatcher:
    """Matches scans against places; it owns one local map, filled anew for each place."""

    def __init__(self, front_end: FrontEndConfig) -> None:
        self.front_end = FrontEnd(front_end, BARE_TANGENT)

    def match(
        self, place: Place, b: Beams, predicted: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
    ) -> Matched:
        """Where the scan fits in the place. predicted: (3,) in the place's frame; cov: (3, 3) in the scan's frame."""
        fe = self.front_end
        fe.hold(place.scans)
        sd = np.sqrt(np.diag(cov))
        start = predicted if max(sd[0], sd[1]) < CLOSURE_SEARCH else self._search(b, predicted, sd)
        match = fe.match(b, start, np.maximum(CLOSURE_MATCH_SD * sd, CLOSURE_MATCH_LEAST))
        innovation = se2.between(predicted, match.pose)
        share = match.matches / max(match.beams, 1)
        refused = Matched(False, "", match.pose, np.zeros((3, 3)), innovation, share, None)
        if match.matches < CLOSURE_LEAST_MATCHES or share < CLOSURE_LEAST_SHARE:
            return refused._replace(reason=f"too few returns match: {match.matches} of {match.beams}")
        lines = believed(fe.information(b, match.pose), CLOSURE_TRUST, CLOSURE_BLUR)
        values, vectors = np.linalg.eigh(lines)
        if values[1] < CLOSURE_LEAST_INFORMATION:
            return refused._replace(reason="the place looks alike in too many directions")
        R = symmetrise(vectors @ np.diag(1.0 / np.maximum(values, 1e-2)) @ vectors.T)
        R = R + np.diag(CLOSURE_FLOOR**2)
        nis = mahalanobis2(innovation, cov + R)
        if nis > CLOSURE_GATE:
            return refused._replace(
                nis=nis,
                reason=f"it lies {np.hypot(*innovation[:2]):.2f} m and {np.degrees(innovation[2]):.1f} degrees from "
                f"where the estimate puts it, {np.sqrt(nis):.1f} standard deviations",
            )
        return Matched(
            True,
            f"{match.matches} of {match.beams} returns match, {np.sqrt(nis):.1f} standard deviations from the estimate",
            match.pose,
            symmetrise(np.linalg.inv(R)),
            innovation,
            share,
            nis,
        )

    def _search(self, b: Beams, predicted: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """The best of a grid of starts around the predicted pose, as far as it is unsure."""
        fe = self.front_end
        thin = slice(None, None, max(1, len(b.q) // CLOSURE_SEARCH_BEAMS))
        s, normal, q = (np.ascontiguousarray(a[thin]) for a in (b.s, b.normal, b.q))
        reach = np.minimum(CLOSURE_SEARCH_SD * sd, [CLOSURE_SEARCH_XY, CLOSURE_SEARCH_XY, CLOSURE_SEARCH_TURN])
        each = zip(reach, CLOSURE_SEARCH_STEPS, strict=True)
        axes = [np.arange(-np.floor(r / h), np.floor(r / h) + 1) * h for r, h in each]
        best, most = predicted, -1
        for dx in axes[0]:
            for dy in axes[1]:
                for turn in axes[2]:
                    pose = se2.compose(predicted, np.array([dx, dy, turn]))
                    n = count_matches(
                        fe.coarse, FRONT_END_COARSE, s, normal, q, 0.0, FRONT_END_AGREE, pose, CLOSURE_SEARCH_REACH
                    )
                    if n > most:
                        best, most = pose, n
        return best
