"""Where landmarks truly are, as someone measured them: for scoring alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .arrays import frozen


@dataclass(frozen=True, slots=True)
class Survey:
    """n surveyed landmarks. xy: (n, 2) [m] in the survey's own frame."""

    ids: tuple[str, ...]
    xy: Float[np.ndarray, "n 2"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "xy", frozen(self.xy))

    def __len__(self) -> int:
        return len(self.ids)


NO_SURVEY = Survey((), np.zeros((0, 2)))
