"""Events through estimators: one function, the same for a log, a simulation and a live session."""

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .records import Event


@runtime_checkable
class Estimator(Protocol):
    """`init -> state`; `step(state, event) -> (state, info)`: state is what goes on, info is what explains."""

    def init(self, robot: str, cfg: Any, rng: np.random.Generator) -> Any: ...
    def step(self, state: Any, event: Event, cfg: Any, rng: np.random.Generator) -> tuple[Any, Any]: ...


@dataclass(frozen=True, slots=True)
class Step:
    """What one event did to one robot's estimate."""

    t: float
    robot: str
    state: Any
    info: Any


def robot_rng(seed: int, robot: str) -> np.random.Generator:
    """A stream of its own for each robot, the same whatever other robots run beside it."""
    return np.random.default_rng([seed, zlib.crc32(robot.encode())])


def run(estimator: Estimator, cfg: Any, events: Iterable[Event], seed: int) -> Iterator[Step]:
    """The trace of `events` (merged or of one robot): one estimator state a robot, made at its first event."""
    states: dict[str, Any] = {}
    rngs: dict[str, np.random.Generator] = {}
    for event in events:
        if event.robot not in states:
            rngs[event.robot] = robot_rng(seed, event.robot)
            states[event.robot] = estimator.init(event.robot, cfg, rngs[event.robot])
        states[event.robot], info = estimator.step(states[event.robot], event, cfg, rngs[event.robot])
        yield Step(event.t, event.robot, states[event.robot], info)
