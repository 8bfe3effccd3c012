"""A team that drives now: two robots and a map process that talk over a network, all of them started from Python."""

import math
import socket
import tempfile
from pathlib import Path
from threading import Thread

import mapweave

with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    at = f"tcp/127.0.0.1:{free.getsockname()[1]}"


def quiet(words: str) -> None:
    """Both kinds of process tell in a line what happens; here nobody listens."""


with tempfile.TemporaryDirectory() as folder:
    home = Path(folder)
    mapweave.simulate_landmarks(home / "team", robots=2, minutes=0.7, seed=4)

    told: dict[str, mapweave.LiveRobot] = {}

    # Each robot is a process on its own machine; here they are threads. A rate of 1 drives in real time.
    def drive(name: str) -> None:
        network = mapweave.Network(connect=(at,))
        told[name] = mapweave.live_robot(
            name, home / "team", rate=math.inf, history=home / name, network=network, say=quiet
        )

    robots = [Thread(target=drive, args=(name,)) for name in ("r1", "r2")]
    for robot in robots:
        robot.start()

    # The map process listens, hears both to the end, and gives what `mapweave.map` gives of the same logs.
    network = mapweave.Network(listen=(at,))
    result = mapweave.live_map(home / "map", robots=["r1", "r2"], network=network, say=quiet)
    for robot in robots:
        robot.join()
    for name in sorted(told):
        print(f"{name} told {told[name].messages} messages")
    print(result.summary())
