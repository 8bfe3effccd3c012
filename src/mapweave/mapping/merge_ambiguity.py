"""What speaks against a place that a map was laid at in another, and the probability that it is right.

Other places speak against it, and directions that nothing holds. The probability is a logistic model, fitted to pairs
of robots in buildings, simulated and real, whose truth is known (`benchmarks/merge_trust.py`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.names import robot_name
from ..laser.place_search import LikelihoodField
from .map_overlap import KeyframeMap, seen_alike
from .merge_search import BLUNDER, KNOWN_ALIKE, LEAST_ALIKE, Candidate, Start

UNCLEAR = 0.003  # of what both saw, added to the share that is not alike: half a point of a few hundred
SLACK = 0.01  # added to what holds along the weakest direction, over what does across it
OWN_WIDE = 0.1  # of what a map contradicts of itself the share that is as wide as a wall, or amid free floor;
WIDE, FREE, ALL = 0.005, 0.01, 0.05  # over widths of walls, amid free floor, and in all what people and doors change
LEAST = 0.002  # probability that is told: of a thousand pairs and more none or one tells less
SIGNS = (0, 1, -1, -1, -1, -1, 1, 1, -1, -1)  # of what speaks for a place, and against it
# of the features, in their order, as `benchmarks/merge_trust.py --fit` found them
WEIGHTS = (1.624, 0.291, -0.582, -4.479, -4.793, -1.853, 0.412, 0.892, -0.503, -0.954)


class Grounds(NamedTuple):
    """What a decision on two maps rests on.

    clear: of what both robots saw, the share alike but for points close to walls; unlike: the share that is not alike;
    walled: share alike when only patches as wide as walls count against it; own: the share that either map
    contradicts of itself, the larger; votes: submaps that say so; others: that say the one other thing that most say;
    rival: evidence of the next best transform over its own, 0 to 1; allowed: whether the maps may lie so too; pushed:
    evidence when the maps are moved along the direction that holds them least, over its own, 0 to 1; held: information
    along that over that across it. How many points both saw, and how far submaps that agree are spread, tell nothing
    more once these are known.
    """

    clear: float = 0.0
    unlike: float = 1.0
    walled: float = 0.0
    own: float = 0.0
    votes: int = 0
    others: int = 0
    rival: float = 1.0
    allowed: bool = False
    pushed: float = 1.0
    held: float = 0.0

    def features(self) -> Float[np.ndarray, " f"]:
        """The numbers that the model weighs, the first of them 1.

        In a building of equal rooms many submaps fit elsewhere too: that counts where the place is contradicted.
        """
        free = _beyond(1.0 - self.clear, OWN_WIDE * self.own, FREE)
        return np.array(
            [
                1.0,
                -math.log(1.0 - self.clear + UNCLEAR),
                _beyond(1.0 - self.walled, OWN_WIDE * self.own, WIDE),
                self.rival,
                float(self.allowed),
                self.pushed,
                math.log(self.held + SLACK),
                math.log1p(self.votes),
                free * math.log1p(self.others),
                _beyond(self.unlike, self.own, ALL) * math.log1p(self.others),
            ]
        )

    def probability(self, weights: Sequence[float] = WEIGHTS) -> float:
        """That the maps lie as the best transform has them, never surer than the trials can tell.

        To 0.5 m and 5 degrees in simulated buildings; where maps of real ones meet, which are bent, to 2 m and 7.
        """
        odds = np.clip(self.features() @ np.asarray(weights), -50.0, 50.0)
        return float(np.clip(1.0 / (1.0 + math.exp(-odds)), LEAST, 1.0 - LEAST))

    def alone(self) -> "Grounds":
        """The same place, were there no other and were it held in every direction."""
        return self._replace(others=0, rival=0.0, allowed=False, pushed=0.0, held=1.0)

    def uncontradicted(self) -> "Grounds":
        """The same place, had neither robot seen through what the other saw."""
        return self._replace(clear=1.0, unlike=0.0, walled=1.0)


def _beyond(share: float, own: float, least: float) -> float:
    """Logarithm of what is contradicted over what the maps contradict of themselves, where it is more."""
    return max(0.0, math.log((share + least) / (own + least)))


LENIENT = 2.0  # times what the best place contradicts, at another place leaves no evidence
RIVAL_LEAD = 5.0  # times the evidence of any other place that is not contradicted
RIVAL_SHARE = 0.1  # of the best place's points seen alike, at another place the maps allow,
RIVAL_SEEN = 100  # points alike there at least,
RIVAL_ALIKE = 0.8, 0.9  # share of what both saw on which they agree there, the more the clearer the best place is:
RIVAL_WORSE = 5.0  # times as much as there may be contradicted at another that it might as well be, and
RIVAL_CLEAR = 0.98  # share of it, but for points close to walls
RIVAL_WALLS = 0.01  # of what both saw: walls that one saw amid the other's free floor, beside those at the best place,
RIVAL_POINTS = 4  # which these few points are in any case
LIGHT_TELLS = 0.6  # correlation of the walls' brightness from which on it tells places apart, and
LIGHT_RIVAL = 0.5  # of it, where another place has less it is as likely as a false start
LEAST_HELD = 0.02  # information along the worst direction over that along the best
SLIDES = (0.8, 1.6, 3.0)  # [m] the map is pushed along its worst direction as a test
PUSH_LEAD = 2.5  # times the evidence of the same place pushed so


class Pair(NamedTuple):
    """Two maps, the walls of the first, a start that was given, and the most that brightness agrees at any place.

    sure: probability from which on they are one; level: share alike at which a place has no evidence, where it is less
    than is asked for.
    """

    a: KeyframeMap
    b: KeyframeMap
    place: LikelihoodField
    sure: float
    start: Start | None = None
    light: float | None = None
    level: float = 1.0

    @property
    def alike(self) -> float:
        """Share of what both saw at which a place has no evidence; near a start that was given less will do."""
        return min(LEAST_ALIKE if self.start is None else KNOWN_ALIKE, self.level)

    def levelled(self, best: Candidate) -> "Pair":
        """The same pair, whose places may be contradicted about as much as the best: people walk, and maps bend."""
        return self._replace(level=max(0.0, 1.0 - LENIENT * (1.0 - best.seen.share)))

    def evidence(self, c: Candidate) -> float:
        """For a transform: what both saw, and how likely the start and the brightness of the walls make it."""
        seen = c.evidence(self.alike)
        if seen <= 0.0:
            return seen
        likelihood = 1.0 if self.start is None else self.start.likelihood(c.transform)
        return seen * likelihood * (BLUNDER if self.darkened(c) else 1.0)

    def against(self, rival: Candidate, best: Candidate) -> float:
        """Evidence of another transform over that of the best, 0 to 1, less where fewer submaps say so."""
        backed = min(1.0, (1 + rival.votes) / (1 + best.votes))
        return float(np.clip(backed * self.evidence(rival) / max(self.evidence(best), 1.0), 0.0, 1.0))

    def grounds(self, c: Candidate) -> Grounds:
        """What a transform rests on were there no other, and were it held in every direction."""
        seen = c.seen
        own = max(self.a.own, self.b.own)
        return Grounds(seen.clear, 1.0 - seen.share, seen.walled, own, c.votes).alone()

    def preference(self, c: Candidate) -> float:
        """Of transforms the greatest is asked: logarithm of its odds, and what a start and the brightness say of it."""
        odds = float(self.grounds(c).features() @ np.asarray(WEIGHTS))
        likelihood = 1.0 if self.start is None else self.start.likelihood(c.transform)
        return odds + float(np.log(likelihood * (BLUNDER if self.darkened(c) else 1.0)))

    def darkened(self, c: Candidate) -> bool:
        """Whether brightness speaks against a transform: walls that meet under it shine unlike, elsewhere alike."""
        if self.light is None or c.light is None:
            return False
        return self.light >= LIGHT_TELLS and c.light < LIGHT_RIVAL * self.light

    def lit_by(self, ways: Sequence[Candidate]) -> "Pair":
        """The same pair with `light` set: the best correlation of brightness among these transforms."""
        seen = [c.light for c in ways if c.light is not None and c.seen.share >= self.alike]
        return self._replace(light=max(seen, default=None))


def possible(other: Candidate, best: Candidate) -> bool:
    """Whether the views contradict walls at another place hardly more than at the best one.

    In a building that looks alike elsewhere walls lie on walls there too, but some stand amid free floor. What is
    smaller than a wall proves nothing: desks are moved.
    """
    seen = other.seen
    amid = (1.0 - seen.walled) * seen.alike / max(seen.walled, 1e-9)
    return amid <= max(RIVAL_POINTS, (RIVAL_WALLS + LENIENT * (1.0 - best.seen.walled)) * seen.alike)


def allowed(pair: Pair, other: Candidate, best: Candidate) -> bool:
    """Whether the maps might as well lie as `other` says: no wall amid free floor, much in common and alike.

    Where a start was given its likelihood says that, and where brightness speaks against it, it is out.
    """
    if pair.start is not None or pair.darkened(other):
        return False
    seen = other.seen
    enough = seen.alike >= max(RIVAL_SEEN, RIVAL_SHARE * best.seen.alike)
    alike = np.clip(1.0 - RIVAL_WORSE * (1.0 - best.seen.share), *RIVAL_ALIKE)
    return enough and seen.clear >= RIVAL_CLEAR and bool(seen.share >= alike) and possible(other, best)


def doubtful(pair: Pair, best: Candidate, rival: Candidate) -> bool:
    """Whether the maps might lie as `rival` says; what a start and brightness say is in its evidence."""
    likely = RIVAL_LEAD * pair.against(rival, best) > 1.0 and possible(rival, best)
    return likely or allowed(pair, rival, best)


class Grip(NamedTuple):
    """How a place holds two maps along the direction that holds them least.

    along: that direction, in words; held: information along it over that across; pushed: the most evidence of the same
    place pushed along it, over its own; 1 where `held` alone lets the maps slide.
    """

    along: str
    held: float
    pushed: float

    def slides(self) -> bool:
        """Whether the maps may be pushed along it without contradiction."""
        return self.held < LEAST_HELD or PUSH_LEAD * self.pushed > 1.0


def grip(pair: Pair, best: Candidate) -> Grip:
    """How a place holds that is allowed."""
    alike = pair.alike
    total = np.zeros((2, 2))
    for h in best.members:
        across = np.array([-h.fit.weak[1], h.fit.weak[0]])
        total += h.fit.held[0] * np.outer(h.fit.weak, h.fit.weak) + h.fit.held[1] * np.outer(across, across)
    values, vectors = np.linalg.eigh(total)
    along = (
        f"the direction of {np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])) % 180.0:.0f} degrees in the map of "
        f"{robot_name(pair.a.robot)}"
    )
    held = float(values[0]) / max(float(values[1]), 1e-12)
    if held < LEAST_HELD:
        return Grip(along, held, 1.0)
    pushes = [sign * step * np.array([*vectors[:, 0], 0.0]) for step in SLIDES for sign in (-1.0, 1.0)]
    seen = [seen_alike(pair.a, pair.b, best.transform + push) for push in pushes]
    most = max(best._replace(seen=there).evidence(alike) for there in seen)
    return Grip(along, held, max(most, 0.0) / max(best.evidence(alike), 1e-12))


def words(T: Float[np.ndarray, "3"]) -> str:
    """A transform for people to read, without a minus before nought."""
    x, y, turn = np.round([T[0], T[1], 0.1 * np.degrees(T[2])], 1) + 0.0
    return f"({x:.1f} m, {y:.1f} m, {10 * turn:.0f} degrees)"
