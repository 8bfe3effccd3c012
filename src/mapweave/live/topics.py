"""Where what is said: the keys of a team.

A robot speaks under `mapweave/<team>/<robot>/` alone, a map process under `mapweave/<team>/@map/<name>/`; no wildcard
for robots takes in a chunk that begins with `@`.
"""

from dataclasses import dataclass

from .messages import Tile

EVERY = "*"
LEVEL = "level"  # in a question for squares: of this one alone


@dataclass(frozen=True, slots=True)
class Topics:
    """The keys of `team`."""

    team: str

    def log(self, robot: str = EVERY) -> str:
        """Numbered messages, published once as they come."""
        return f"mapweave/{self.team}/{robot}/log"

    def history(self, robot: str = EVERY) -> str:
        """Answers `?first=A;last=B` with the numbered messages A to B, one reply each."""
        return f"mapweave/{self.team}/{robot}/history"

    def status(self, robot: str = EVERY) -> str:
        return f"mapweave/{self.team}/{robot}/status"

    def snapshot(self, robot: str = EVERY) -> str:
        return f"mapweave/{self.team}/{robot}/snapshot"

    def clock(self, robot: str = EVERY) -> str:
        """Answers with the robot's wall clock [s] in decimals."""
        return f"mapweave/{self.team}/{robot}/clock"

    def alive(self, robot: str = EVERY) -> str:
        """The liveliness token of a robot."""
        return f"mapweave/{self.team}/{robot}/alive"

    def map_state(self, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/state"

    def map_alive(self, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/alive"

    def correction(self, robot: str, name: str = EVERY) -> str:
        return f"mapweave/{self.team}/@map/{name}/correction/{robot}"

    def goal(self, robot: str, name: str = EVERY) -> str:
        """Where a robot is to drive, told again and again."""
        return f"mapweave/{self.team}/@map/{name}/goal/{robot}"

    def tile(self, name: str = EVERY, tile: Tile | None = None, level: int | None = None) -> str:
        """One square of the map, published when it has changed; of all of them, or all of a level."""
        where = "**" if level is None else f"*/{level}/*/*"
        if tile is not None:
            where = f"{tile.component}/{tile.level}/{tile.i}/{tile.j}"
        return f"mapweave/{self.team}/@map/{name}/tile/{where}"

    def tiles(self, name: str = EVERY) -> str:
        """Answers with all squares of the map, or `?level=L` with those of a level, one reply each."""
        return f"mapweave/{self.team}/@map/{name}/tiles"

    def robot_of(self, key: str) -> str:
        """Whose key it is."""
        return key.split("/")[2]

    def map_of(self, key: str) -> str:
        """Which map process's key it is."""
        return key.split("/")[3]
