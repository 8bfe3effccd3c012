"""Loop closures: a keyframe matched against an old place, and why the match is believed or not."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import mahalanobis2, symmetrise
from ..kernels.laser.local_map import count_matches
from .beam import Beams
from .scan_matching import FrontEnd, FrontEndConfig
from .team_config import ClosureConfig
from .team_odometry import believed


@dataclass(frozen=True, slots=True)
class Closure:
    """Keyframe `second` of robot robots[1] matched against the place of keyframe `first` of robots[0].

    measured: (3,) pose of second in first; information: (3, 3) in second's frame; innovation: (3,) by which the match
    differs from the estimate, in second's frame; share: of the returns matched; nis: squared innovation in standard
    deviations (None when no match was made); reason: plain words.
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


class Matcher:
    """Matches scans against places; it owns one local map, filled anew for each place."""

    def __init__(self, cfg: ClosureConfig, front_end: FrontEndConfig) -> None:
        self.cfg = cfg
        self.front_end = FrontEnd(front_end, front_end.bare_tangent)

    def match(
        self, place: Place, b: Beams, predicted: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
    ) -> Matched:
        """Where the scan fits in the place. predicted: (3,) in the place's frame; cov: (3, 3) in the scan's frame."""
        c, fe = self.cfg, self.front_end
        fe.hold(place.scans)
        sd = np.sqrt(np.diag(cov))
        start = predicted if max(sd[0], sd[1]) < c.search else self._search(b, predicted, sd)
        found = fe.match(b, start, np.maximum(3.0 * sd, [0.3, 0.3, 0.1]))
        innovation = se2.between(predicted, found.pose)
        share = found.matches / max(found.beams, 1)
        nothing = Matched(False, "", found.pose, np.zeros((3, 3)), innovation, share, None)
        if found.matches < c.least_matches or share < c.least_share:
            return nothing._replace(reason=f"too few returns match: {found.matches} of {found.beams}")
        told = believed(fe.information(b, found.pose), c.trust, c.blur)
        values, vectors = np.linalg.eigh(told)
        if values[1] < 1.0:
            return nothing._replace(reason="the place looks alike in too many directions")
        R = symmetrise(vectors @ np.diag(1.0 / np.maximum(values, 1e-2)) @ vectors.T)
        R = R + np.diag([c.floor_xy**2, c.floor_xy**2, c.floor_turn**2])
        nis = mahalanobis2(innovation, cov + R)
        if nis > c.gate:
            return nothing._replace(
                nis=nis,
                reason=f"it lies {np.hypot(*innovation[:2]):.2f} m and {np.degrees(innovation[2]):.1f} degrees from "
                f"where the estimate puts it, {np.sqrt(nis):.1f} standard deviations",
            )
        return Matched(
            True,
            f"{found.matches} of {found.beams} returns match, {np.sqrt(nis):.1f} standard deviations from the estimate",
            found.pose,
            symmetrise(np.linalg.inv(R)),
            innovation,
            share,
            nis,
        )

    def _search(self, b: Beams, predicted: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """The best of a grid of starts within 2.5 standard deviations, 3 m and 0.3 rad at most."""
        fe, thin = self.front_end, slice(None, None, max(1, len(b.q) // 90))
        s, normal, q = (np.ascontiguousarray(a[thin]) for a in (b.s, b.normal, b.q))
        reach = np.minimum(2.5 * sd, [3.0, 3.0, 0.3])
        axes = [
            np.arange(-np.floor(r / h), np.floor(r / h) + 1) * h for r, h in zip(reach, (0.3, 0.3, 0.04), strict=True)
        ]
        best, most = predicted, -1
        for dx in axes[0]:
            for dy in axes[1]:
                for turn in axes[2]:
                    pose = se2.compose(predicted, np.array([dx, dy, turn]))
                    n = count_matches(fe.coarse, fe.cfg.coarse, s, normal, q, 0.0, fe.cfg.agree, pose, 0.15)
                    if n > most:
                        best, most = pose, n
        return best
