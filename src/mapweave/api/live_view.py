"""The shared map of a team in a browser."""

import webbrowser
from collections.abc import Callable
from threading import Event

from ..live.messages import check_name
from ..live.topics import Topics
from ..live.transport import LISTENING, Network, session
from ..live.view import Board, follow, served

LOOKED = 1.0  # [s] from one look at what had no room to the next

Say = Callable[[str], None]


def live_view(
    *,
    port: int = 8642,
    host: str = "127.0.0.1",
    browser: bool = False,
    network: Network | None = None,
    stop: Event | None = None,
    say: Say = print,
) -> None:
    """Serve the page of a team's shared map until `stop` is set: map, robots, who is there, decisions.

    Parameters
    ----------
    port
        Where the page stands (8642); 0 is any that is free.
    host
        The address it is served on (this machine alone).
    browser
        Open it in a browser.
    network
        How to reach the team (those on this network find each other).
    stop
        Ends it as soon as it is set.
    say
        Called with a line that names the address.
    """
    network = network or Network()
    check_name(network.team, "--team")
    board = Board()
    with served(board, host, port) as address, session(network, lambda at: say(f"{LISTENING}{at}")) as opened:
        held = follow(opened, Topics(network.team), board)
        say(f"team {network.team}: {address}")
        if browser:
            webbrowser.open(address)
        stop, told = stop or Event(), False
        while not stop.wait(LOOKED):
            if board.let_go and not told:
                told = True
                say("more maps, robots or squares are told than there is room for: the oldest are not shown")
        del held
