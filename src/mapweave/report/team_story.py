"""What the report of a team's map is told from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..core.names import in_order
from ..core.records import Track
from ..core.truth import NO_SURVEY, Survey
from ..evaluation.growth import GrowthPoint
from ..evaluation.team import RobotTruth, TeamScore
from ..fusion.result import Fusion
from ..landmarks.landmark_map import LocalMap
from ..team.smooth import Smoothed
from ..team.team_map import TeamMap


@dataclass(frozen=True, slots=True)
class TeamStory:
    """The fused components (largest first), what each robot handed over, why each was merged or not, and the scores."""

    title: str
    maps: Sequence[TeamMap]
    local: Sequence[LocalMap]
    fusion: Fusion
    growth: Sequence[GrowthPoint] = ()
    score: TeamScore | None = None
    survey: Survey = NO_SURVEY
    truths: Mapping[str, RobotTruth] = field(default_factory=dict)
    smoothed: Sequence[Smoothed] = ()
    filter_score: TeamScore | None = None
    warnings: Sequence[str] = ()

    @property
    def robots(self) -> tuple[str, ...]:
        """All robots in order; the place in it gives a robot its colour."""
        return tuple(sorted((m.robot for m in self.local), key=in_order))

    def colour_of(self, robot: str) -> int:
        return self.robots.index(robot)


def thinned(track: Track, most: int = 3000) -> np.ndarray:
    """At most about `most` poses of a track, enough to draw it."""
    return np.asarray(track.pose[:: max(1, len(track.t) // most)])
