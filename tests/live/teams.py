"""A small simulated team, and its messages."""

import tempfile
from functools import cache
from pathlib import Path

from mapweave.api.simulate import simulate_landmarks
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.live.inbox import Inbox
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


def heard(store, told):
    """The inbox of a map process that heard what was `told`: name -> messages, in order."""
    return _offered(store, [(name, payload) for name, each in told.items() for payload in each])


def heard_late_and_twice(store, told, rng):
    """The same, in any order, a third of the messages twice."""
    every = [(name, payload) for name, each in told.items() for payload in each]
    every += [every[i] for i in rng.integers(len(every), size=len(every) // 3)]
    return _offered(store, [every[i] for i in rng.permutation(len(every))])


def _offered(store, every):
    inbox = Inbox(store)
    for name, payload in every:
        inbox.offer(name, payload, 0.0)
    inbox.save()
    return inbox
