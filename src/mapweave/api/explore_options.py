"""Options every kind of exploration takes."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TypeVar

from ..core.errors import ConfigError, UsageError
from ..core.paths import AnyConfig
from ..core.workers import Progress, worker_pool
from ..exploration.mission import RunScore
from ..io.directory import check_target
from ..io.kept import kept_parts, part
from ..report.result import ResultBase

Score = TypeVar("Score", bound=RunScore)
Record = TypeVar("Record")
Result = TypeVar("Result", bound=ResultBase)
LOUDEST = 1e4  # times the usual noise, far beyond what any filter bears
LARGEST = 1e9  # no length, count or weight of an exploration is beyond


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ExploreOptions:
    """What `explore` is asked for, among landmarks and among walls; a planner of None is the scenario's own.

    Raises UsageError for a number of runs, a seed, a number of processes or a share that cannot be.
    """

    robots: int | None
    runs: int
    seed: int
    planner: str | None
    association: str | None
    noise: str | float
    until: str | int
    kill: Mapping[str, int] | None
    drop: float
    config: AnyConfig | None
    jobs: int
    executor: Executor | None
    out: Path | str | None
    force: bool
    on_progress: Progress

    def __post_init__(self) -> None:
        if self.runs < 1 or self.jobs < 1:
            raise UsageError(f"--runs and --jobs: expected at least 1, found {self.runs} and {self.jobs}")
        if self.seed < 0:
            raise UsageError(f"--seed: expected 0 or more, found {self.seed}")
        if not 0 <= self.drop < 1:
            raise UsageError(f"--drop: expected a share of messages from 0 to below 1, found {self.drop:g}")

    def explore(
        self,
        once: Callable[[int], tuple[Score, Record]],
        many: Callable[[int, int, Executor | None], list[Score]],
        result: Callable[[tuple[Score, ...], Record], Result],
        *,
        ours: bool,
        **callbacks: Callable[[int, float], None],
    ) -> Result:
        """The result of all runs, numbered from 0, written to `out` if given; a folder that is refused stops it first.

        once: seed -> score and record of the first run; many: (how many, the seed of the first, where to run them) ->
        scores; result: (scores, the first run's record) -> what `explore` gives; ours: no module and no file beside
        decides what happens, so that finished runs can be kept;
        callbacks: who hears of the first run, by the names that `once` knows.
        """
        if self.out is not None:
            check_target(Path(self.out), force=self.force)
        self.on_progress("exploring", 0, self.runs)
        with kept_parts() if ours else nullcontext():
            score, first = part(once, self.seed, **callbacks)
            exploration = result(self._scored(score, many), first)
            if self.out is not None:
                exploration.write(self.out, force=self.force)
        return exploration

    def _scored(self, first: Score, many: Callable[[int, int, Executor | None], list[Score]]) -> tuple[Score, ...]:
        scores = [first]
        self.on_progress("exploring", 1, self.runs)
        with worker_pool(self.jobs, self.runs - 1, self.executor) as workers:
            step = max(1, self.jobs) * 2
            for start in range(1, self.runs, step):
                scores += many(min(step, self.runs - start), self.seed + start, workers)
                self.on_progress("exploring", len(scores), self.runs)
        return tuple(replace(score, run=k) for k, score in enumerate(scores))


def factor_of(noise: str | float, names: str) -> float:
    """A positive factor; `names` are the words that would have been understood too."""
    try:
        factor = float(noise)
    except ValueError:
        raise UsageError(f"--noise: expected {names} or a factor, found {noise!r}") from None
    if not 0 < factor <= LOUDEST:
        raise UsageError(f"--noise: expected a positive factor up to {LOUDEST:g}, found {noise!r}")
    return factor


def end_of(until: str | int, *words: str) -> str | int:
    """One of `words`, or a number of steps, at least one."""
    if isinstance(until, str) and until in words:
        return until
    try:
        steps = int(until)
    except ValueError:
        raise UsageError(f"--until: expected {', '.join(words)} or a number of steps, found {until!r}") from None
    if steps < 1:
        raise UsageError(f"--until: expected at least 1 step, found {steps}")
    return steps


def check_magnitudes(cfg: object, where: str) -> None:
    """Raises ConfigError that lists every number of `cfg`, tables included, that is beyond `LARGEST`."""
    wild = [f"{key}: expected at most {LARGEST:g}, found {v:g}" for key, v in _numbers(cfg, "") if abs(v) > LARGEST]
    if wild:
        raise ConfigError(f"{where}: {'; '.join(wild)}")


def _numbers(value: object, key: str) -> Iterator[tuple[str, float]]:
    """Every number under `value` with its dotted name."""
    if is_dataclass(value):
        for f in fields(value):
            yield from _numbers(getattr(value, f.name), f"{key}.{f.name}" if key else f.name)
    elif isinstance(value, tuple):
        for k, v in enumerate(value):
            yield from _numbers(v, f"{key}.{k}")
    elif isinstance(value, int | float):
        yield key, value


def kills_of(kill: Mapping[str, int], robots: int) -> dict[int, int]:
    """The step at which each robot dies, by number from 0; a name that no robot has is refused."""
    names = {f"robot{k + 1}": k for k in range(robots)}
    for name in kill:
        if name not in names:
            raise UsageError(f"--kill: no robot is called {name!r}; there are {', '.join(names)}")
    return {names[name]: step for name, step in kill.items()}
