"""The probability that two maps lie as a decision on them has it, from what the decision rests on.

A logistic model, fitted to pairs of robots in buildings, simulated and real, whose truth is known
(`benchmarks/merge_trust.py`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
