"""What fusing gives: one map for each component, and a plain reason for every merge made or refused."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..landmarks.landmark_map import LandmarkMap


@dataclass(frozen=True, slots=True)
class Decision:
    """Why one robot's map was merged or not.

    shared: landmarks in common with the rest; scale: the multiplicative scale found for its map; variance_factor:
    what its covariance was multiplied by, found from the join's own residuals.
    """

    robot: str
    shared: int
    decision: str  # "reference", "merged" or "refused"
    reason: str
    scale: float | None = None
    variance_factor: float | None = None


@dataclass(frozen=True, slots=True)
class Component:
    """Robots tied together and their one map. `frames[k]` is `T_map_local_k`; `frame_cov[k]`: over x, y, theta."""

    robots: tuple[str, ...]
    map: LandmarkMap
    frames: Mapping[str, Float[np.ndarray, "3"]]
    frame_cov: Mapping[str, Float[np.ndarray, "3 3"]]
    members: Mapping[str, tuple[str, ...]]  # landmark id -> robots that saw it
    scales: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Fusion:
    """All components, the largest first, and a decision for every robot.

    labels[robot]: own landmark name -> name in the map, where they differ (exchanged labels, unknown identities).
    """

    components: tuple[Component, ...]
    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...] = ()
    labels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def own_name(self, robot: str, name: str) -> str:
        """What `robot` calls the landmark that is `name` in the map."""
        return next((own for own, common in self.labels.get(robot, {}).items() if common == name), name)

    def about(self, robot: str) -> tuple[str, ...]:
        """The warnings that speak of `robot`'s map alone, without its name."""
        start = f"{robot}: "
        return tuple(w.removeprefix(start) for w in self.warnings if w.startswith(start))
