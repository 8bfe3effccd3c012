"""How far another's wall clock is off, from questions and answers."""

import math
from collections import deque
from dataclasses import dataclass, field

KEPT = 8  # questions


@dataclass(slots=True)
class ClockOffset:
    """The other's clock minus ours [s]. An answer bounds it by half of the time that the question took."""

    _heard: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, asked: float, remote: float, answered: float) -> None:
        """`remote`: the other's clock; asked, answered: ours around it [s]. Raises ValueError for what is no time."""
        if not math.isfinite(remote):
            raise ValueError(remote)
        if answered >= asked:  # else our own clock was set back meanwhile
            self._heard.append((0.5 * (answered - asked), remote - 0.5 * (asked + answered)))

    @property
    def known(self) -> bool:
        return bool(self._heard)

    @property
    def best(self) -> tuple[float, float]:
        """The offset of the quickest answer of late and what it may be wrong by [s]; (0, inf) before any."""
        if not self._heard:
            return 0.0, math.inf
        error, offset = min(self._heard)
        return offset, error
