"""How smoothing went while the logs played: what it took, what it came to, and intermediate maps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.findings import Finding
from ..core.names import robot_key
from ..landmarks.landmark_map import LandmarkMap
from .online import OnlineTeam


@dataclass(frozen=True, slots=True)
class OnlineMap:
    """The largest component `t` [s] after the first row of all logs; robots: how many were tied in."""

    t: float
    robots: int
    landmarks: LandmarkMap


@dataclass(frozen=True, slots=True)
class OnlineRun:
    """What smoothing while the logs played took, and what it came to.

    step: [s] of the logs taken in at once; seconds: (n,) each step took; lag: (n,) [s] from the oldest row of a step
    until the map held it, were the logs as fast as the robots; linearised: stretches of each step; renewed: of these
    older ones that had moved; laid_out: [s] after the first row at which robots or landmarks came in; stretches: how
    many there are, none of them given up; closing: [s] for what was left to do when the logs ended; landmarks_moved,
    ways_moved: [m] root mean square by which that changed them; growth: intermediate maps; waited: robots without
    wheels, whose rows came in when the logs ended.
    """

    team: OnlineTeam | None
    step: float
    seconds: Float[np.ndarray, " n"]
    lag: Float[np.ndarray, " n"]
    linearised: Float[np.ndarray, " n"]
    renewed: int
    laid_out: tuple[float, ...]
    stretches: int
    growth: tuple[OnlineMap, ...]
    closing: float = 0.0
    landmarks_moved: float | None = None
    ways_moved: float | None = None
    waited: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A finding where nothing, or not every robot, could be smoothed before the end."""
        if self.team is not None and self.team.members:
            robots = ", ".join(map(robot_key, self.waited))
            why = f"no wheels: smoothed when the logs ended: robot {robots}"
            return (Finding("smoothed-late", value=why),) if robots else ()
        why = "no robot with wheels had a map while the logs played: all was smoothed at their end"
        return (Finding("smoothed-late", value=why),)

    def timing(self) -> dict[str, float]:
        """Seconds a step and seconds of lag: mean, 99 % and largest; and of the closing."""
        out: dict[str, float] = {}
        for name, values in (("step", self.seconds), ("lag", self.lag)):
            if len(values):
                statistics = (values.mean(), np.quantile(values, 0.99), values.max())
                out |= {f"{name}_{k}": float(v) for k, v in zip(("mean", "p99", "max"), statistics, strict=True)}
        return out | {"closing": self.closing}
