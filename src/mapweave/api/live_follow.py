"""What a live team knows, for a program: its map, where its robots are, where they are sent."""

from collections.abc import Iterator
from contextlib import contextmanager

from ..core.errors import UsageError
from ..live.messages import check_name
from ..live.tiles import LEVELS
from ..live.told import LiveTeam, hear_team
from ..live.topics import Topics
from ..live.transport import Network, session


@contextmanager
def live_follow(*, level: int = 0, network: Network | None = None) -> Iterator[LiveTeam]:
    """Follow a live team from a program: within the block what it gives tells how the team stands, at any time.

    Parameters
    ----------
    level
        Of the map's squares that are heard: 0 is as fine as the map is made, 1 and 2 four times coarser each (0).
    network
        How to reach the team (those on this network find each other).

    Raises
    ------
    UsageError
        For a level that there is none of, a team's name that cannot be, an endpoint that is none.
    """
    network = network or Network()
    check_name(network.team, "--team")
    if level not in range(LEVELS):
        raise UsageError(f"level: expected 0 to {LEVELS - 1}, found {level}")
    team = LiveTeam()
    with session(network) as opened:
        held = hear_team(opened, Topics(network.team), team, level=level)
        yield team
        del held
