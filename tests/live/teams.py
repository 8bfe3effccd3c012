"""A small simulated team, and its messages."""

import tempfile
from functools import cache
from pathlib import Path

from mapweave.api.simulate import simulate_landmarks
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.live.landmark_stream import messages_of
from mapweave.live.messages import encode


@cache
def team(robots=2, minutes=0.3, seed=4):
    """Logs of a simulated team."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_landmarks(Path(folder, "team"), robots=robots, minutes=minutes, seed=seed)
        return read_landmark_logs(Path(folder, "team"))


def messages(log, robot="r1", run="a", period=1.0):
    return [m for _, m in messages_of(log, robot, run, period)]


def payloads(log, robot="r1", run="a"):
    return [encode(m) for m in messages(log, robot, run)]
