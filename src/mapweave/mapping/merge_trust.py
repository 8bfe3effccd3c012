"""The probability that two maps lie as a decision on them has it, from what the decision rests on.

A logistic model, fitted to simulated pairs of robots whose truth is known (`benchmarks/merge_trust.py`).
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

UNCLEAR = 0.003  # of what both saw, added to the share that is not alike: half a point of a few hundred
SLACK = 0.01  # added to what holds along the weakest direction, over what does across it
LEAST = 0.002  # probability that is told: of a thousand pairs and more none or one tells less
SIGNS = (0, 1, -1, -1, -1, 1, -1)  # of what speaks for a place, and against it
# of the features, in their order, as `benchmarks/merge_trust.py --fit` found them
WEIGHTS = (-1.522, 1.266, -2.430, -5.663, -1.910, 0.754, -3.648)


class Grounds(NamedTuple):
    """What a decision on two maps rests on.

    clear: of what both robots saw, the share alike but for points close to walls; rival: evidence of the next best
    transform over its own, 0 to 1; allowed: whether the maps may lie so too; pushed: evidence when the maps are moved
    along the direction that holds them least, over its own, 0 to 1; held: information along that over that across it;
    spread: [m] of the submaps that confirm the transform. How many do, and how much both saw, tell nothing more once
    these are known.
    """

    clear: float = 0.0
    rival: float = 1.0
    allowed: bool = False
    pushed: float = 1.0
    held: float = 0.0
    spread: float = 0.0

    def features(self) -> Float[np.ndarray, " f"]:
        """The numbers that the model weighs, the first of them 1."""
        return np.array(
            [
                1.0,
                -math.log(1.0 - self.clear + UNCLEAR),
                self.rival,
                float(self.allowed),
                self.pushed,
                math.log(self.held + SLACK),
                self.spread,
            ]
        )

    def probability(self) -> float:
        """That the maps lie within 0.5 m and 5 degrees of the best transform; never surer than the trials can tell."""
        odds = float(self.features() @ np.asarray(WEIGHTS))
        return float(np.clip(1.0 / (1.0 + math.exp(-np.clip(odds, -50.0, 50.0))), LEAST, 1.0 - LEAST))
