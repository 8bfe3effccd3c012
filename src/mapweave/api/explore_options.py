"""Options every kind of exploration takes."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from typing import TypeVar

import numpy as np

from ..core.errors import UsageError
from ..core.progress import Progress
from ..core.workers import worker_pool

Score = TypeVar("Score")


def parse_kills(text: list[str] | None) -> dict[str, int]:
    """`robot2@100` -> {"robot2": 100}."""
    out: dict[str, int] = {}
    for word in text or []:
        name, at, step = word.partition("@")
        if not at or not step.isdecimal():
            raise UsageError(f"--kill: expected robotK@STEP, found {word!r}")
        if name in out:
            raise UsageError(f"--kill: {name} can die but once, found {name}@{out[name]} and {word}")
        out[name] = int(step)
    return out


def remaining_runs(
    many: Callable[[int, int, Executor | None], list[Score]],
    runs: int,
    seed: int,
    jobs: int,
    executor: Executor | None,
    on_progress: Progress,
) -> list[Score]:
    """Scores of runs 1, 2, ... `runs` - 1, a few at a time, so that progress can be told; run 0 is there already.

    many: (how many, the seed of the first, where to run them) -> their scores.
    """
    scores: list[Score] = []
    with worker_pool(jobs, runs - 1, executor) as workers:
        step = max(1, jobs) * 2
        for start in range(1, runs, step):
            scores += many(min(step, runs - start), seed + start, workers)
            on_progress("exploring", 1 + len(scores), runs)
    return scores


def factor_of(noise: str | float, names: str) -> float:
    """A positive factor; `names` are the words that would have been understood too."""
    try:
        factor = float(noise)
    except ValueError:
        raise UsageError(f"--noise: expected {names} or a factor, found {noise!r}") from None
    if not (np.isfinite(factor) and factor > 0):
        raise UsageError(f"--noise: expected a positive factor, found {noise!r}")
    return factor


def steps_of(until: str | int, names: str) -> int:
    """At least one step; `names` are the words that would have been understood too."""
    try:
        steps = int(until)
    except ValueError:
        raise UsageError(f"--until: expected {names} or a number of steps, found {until!r}") from None
    if steps < 1:
        raise UsageError(f"--until: expected at least 1 step, found {steps}")
    return steps


def kills_of(kill: Mapping[str, int], robots: int) -> dict[int, int]:
    names = {f"robot{k + 1}": k for k in range(robots)}
    for name in kill:
        if name not in names:
            raise UsageError(f"--kill: no robot is called {name!r}; there are {', '.join(names)}")
    return {names[name]: step for name, step in kill.items()}


def check_numbers(*, runs: int, seed: int, jobs: int, drop: float) -> None:
    """Raises UsageError for a number of runs, a seed, a number of processes or a share that cannot be."""
    if runs < 1 or jobs < 1:
        raise UsageError(f"--runs and --jobs: expected at least 1, found {runs} and {jobs}")
    if seed < 0:
        raise UsageError(f"--seed: expected 0 or more, found {seed}")
    if not 0 <= drop < 1:
        raise UsageError(f"--drop: expected a share of messages from 0 to below 1, found {drop:g}")
