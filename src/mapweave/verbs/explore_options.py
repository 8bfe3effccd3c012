"""Options every kind of exploration takes."""

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from typing import Any

from ..core.errors import UsageError


def parse_kills(text: list[str] | None) -> dict[str, int]:
    """`robot2@100` -> {"robot2": 100}."""
    out: dict[str, int] = {}
    for word in text or []:
        name, at, step = word.partition("@")
        if not at or not step.isdecimal():
            raise UsageError(f"--kill: expected robotK@STEP, found {word!r}")
        out[name] = int(step)
    return out


def worker_pool(jobs: int, runs: int) -> Any:
    """Processes for `runs` runs, as a context; None inside it when one is enough."""
    if jobs < 2 or runs < 3:
        return nullcontext(None)
    return ProcessPoolExecutor(min(jobs, runs - 1), mp_context=get_context("spawn"))


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
