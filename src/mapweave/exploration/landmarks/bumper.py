"""What happens where a robot's true motion meets a wall: it stops short of it, and the team remembers the place."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.walls import Walls


@dataclass(slots=True)
class Bumper:
    """collisions: how often a wall stopped a robot, one that lasts counting once; contacts: step and place (2,)."""

    walls: Walls | None
    radius: float  # [m]
    collisions: int = 0
    contacts: list[tuple[int, np.ndarray]] = field(default_factory=list)
    touching: set[int] = field(default_factory=set)  # robots stopped in the last step

    def stop(self, j: int, here: Float[np.ndarray, "2"], pose: Float[np.ndarray, "3"], command: np.ndarray) -> bool:
        """Whether a wall stopped robot j between the true place `here` and `pose`.

        Then `pose` is where it stands, and `command` what it carried out, both in place.
        """
        if self.walls is None:
            return False
        share = self.walls.free_share(here, pose[:2], self.radius)
        if share == 1.0:
            self.touching.discard(j)
            return False
        pose[:2] = here + share * (pose[:2] - here)
        if command[0] == 0.0:  # it turned on the spot and slipped
            return False
        command[0] *= share
        self.collisions += j not in self.touching
        self.touching.add(j)
        return True

    def remember(self, step: int, pose: Float[np.ndarray, "3"], heading: float) -> None:
        """A robot at the estimated `pose` in the map, driving along `heading`, met a wall: a radius ahead of it."""
        ahead = self.radius * np.array([np.cos(heading), np.sin(heading)])
        self.contacts.append((step, pose[:2] + ahead))

    def forget(self, before: int) -> None:
        """Contacts of step `before` and earlier are gone."""
        self.contacts = [c for c in self.contacts if c[0] > before]

    def places(self) -> Float[np.ndarray, "k 2"]:
        """Where walls were met."""
        return np.array([p for _, p in self.contacts]).reshape(-1, 2)
