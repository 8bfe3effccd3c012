"""A field with point landmarks and the robots' starts: the world of [Yuan09], and walls if there are any."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError
from ..core.records import frozen
from ..core.walls import Walls

START_RADIUS = 5.0  # [m], of the circle on which teams start unless said
# the paper's field: corners [m] and landmarks
YUAN_LOWER, YUAN_UPPER, YUAN_LANDMARKS = (-50.0, -40.0), (50.0, 40.0), 29


@dataclass(frozen=True, slots=True)
class Field:
    """A rectangle `lower`..`upper` [m] with landmarks (n, 2), named by their row, and the robots' starts (M, 3)."""

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    landmarks: Float[np.ndarray, "n 2"]
    starts: Float[np.ndarray, "r 3"]
    walls: Walls | None = None

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "landmarks", "starts"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if len(self.landmarks) == 0:
            raise DataError("the scenario has no landmarks: there is nothing to map")
        if len(self.starts) == 0:
            raise DataError("the scenario has no robots")
        for what, points in (("landmark", self.landmarks), ("robot", self.starts[:, :2])):
            outside = np.flatnonzero(~self.inside(points))
            if len(outside):
                x, y = points[outside[0]]
                raise DataError(f"{what} {outside[0] + 1} at ({x:g}, {y:g}) lies outside the field")
            if self.walls is not None:
                walled = np.flatnonzero(self.walls.clearance(points) <= 0.0)
                if len(walled):
                    x, y = points[walled[0]]
                    raise DataError(f"{what} {walled[0] + 1} at ({x:g}, {y:g}) lies inside a wall")

    def inside(self, points: Float[np.ndarray, "... 2"]) -> np.ndarray:
        """Which of `points` lie in the field."""
        return np.asarray(np.all((points >= self.lower) & (points <= self.upper), axis=-1))


def circle_of_starts(robots: int, radius: float = START_RADIUS) -> Float[np.ndarray, "r 3"]:
    """Starts of a team: the origin for one robot, else evenly on a circle facing out (the paper's two for two)."""
    if robots == 1:
        return np.zeros((1, 3))
    angle = np.pi + 2 * np.pi * np.arange(robots) / robots
    heading = np.arctan2(np.sin(angle), np.cos(angle))
    heading[0] = np.pi
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), heading], axis=-1)
