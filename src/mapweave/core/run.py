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


class Runner:
    """Events one by one through an estimator, as they come. `push` changes it.

    states: robot -> its latest state, made at its first event.
    """

    def __init__(self, estimator: Estimator, cfg: Any, seed: int) -> None:
        self.estimator, self.cfg, self.seed = estimator, cfg, seed
        self.states: dict[str, Any] = {}
        self._rngs: dict[str, np.random.Generator] = {}

    def push(self, event: Event) -> Step:
        """What the event did to its robot's estimate."""
        robot = event.robot
        if robot not in self.states:
            self._rngs[robot] = robot_rng(self.seed, robot)
            self.states[robot] = self.estimator.init(robot, self.cfg, self._rngs[robot])
        self.states[robot], info = self.estimator.step(self.states[robot], event, self.cfg, self._rngs[robot])
        return Step(event.t, robot, self.states[robot], info)


def run(estimator: Estimator, cfg: Any, events: Iterable[Event], seed: int) -> Iterator[Step]:
    """The trace of `events` (merged or of one robot): one estimator state a robot, made at its first event."""
    runner = Runner(estimator, cfg, seed)
    for event in events:
        yield runner.push(event)
