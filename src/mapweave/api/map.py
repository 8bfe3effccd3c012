"""One map from the logs of a team: which kind of log it is decides who maps."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

from ..core.errors import ReaderError, UsageError
from ..core.progress import Progress, no_progress
from ..core.threads import one_blas_thread
from ..io.directory import check_target
from .map_options import LaserOptions, MapOptions, MapResult


@runtime_checkable
class Mapper(Protocol):
    """A module that maps one kind of log. `applies` looks at names and first lines only."""

    __name__: str

    def applies(self, log: Path) -> bool: ...
    def map_logs(self, logs: Sequence[Path], options: MapOptions) -> MapResult: ...


LASER = "mapweave.api.map_laser"
MAPPERS: tuple[str, ...] = (
    # asked in this order; the first that applies to every log maps them
    "mapweave.api.map_landmarks",
    LASER,
)


@one_blas_thread()
def map(  # noqa: A001  (the verb)
    logs: Path | str | Sequence[Path | str],
    out: Path | str | None = None,
    *,
    robots: Sequence[str] | None = None,
    method: str | None = None,
    weights: str | None = None,
    share: Mapping[str, float] | None = None,
    start: Mapping[str, tuple[float, float, float]] | None = None,
    truth: Path | str | Sequence[Path | str] | None = None,
    config: Path | str | None = None,
    seed: int = 0,
    jobs: int = 1,
    fuse_every: float | None = None,
    refine: bool = True,
    laser: LaserOptions | None = None,
    force: bool = False,
    executor: Executor | None = None,
    on_progress: Progress = no_progress,
) -> MapResult:
    """The map of `logs`, written to the folder `out` when one is given.

    Robots are called `"1"`, `"2"`; `start` gives first poses [m, m, rad] in the map; `truth` is used for scoring alone;
    `laser` is for laser logs.
    Any `concurrent.futures` executor may be given; the result does not depend on it.
    Raises ReaderError, DataError, EstimateError or UsageError; nothing is written then.
    """
    paths = [Path(logs)] if isinstance(logs, Path | str) else [Path(p) for p in logs]
    options = MapOptions(
        robots=None if robots is None else tuple(robots),
        method=method,
        weights=weights,
        share=dict(share or {}),
        start=dict(start or {}),
        truth=_paths(truth),
        config=None if config is None else Path(config),
        seed=seed,
        jobs=jobs,
        fuse_every=fuse_every,
        refine=refine,
        laser=laser or LaserOptions(),
        executor=executor,
        on_progress=on_progress,
    )
    options.check()
    if out is not None:
        check_target(Path(out), force=force)
    mapper = _mapper(paths)
    if (given := options.laser.given()) and mapper.__name__ != LASER:
        raise UsageError(f"{', '.join(given)}: only for laser logs, found {paths[0]}")
    result = mapper.map_logs(paths, options)
    if out is not None:
        result.write(out, force=force)
    return result


def _mapper(logs: Sequence[Path]) -> Mapper:
    if not logs:
        raise UsageError("expected a log, found none")
    for path in logs:
        if not path.exists():
            raise ReaderError(path, "no such file or folder")
    for where in MAPPERS:
        mapper = cast("Mapper", import_module(where))
        fits = [mapper.applies(path) for path in logs]
        if all(fits):
            return mapper
        if any(fits):
            other = logs[fits.index(False)]
            raise ReaderError(other, f"expected the same kind of log as {logs[fits.index(True)]}, found another")
    raise ReaderError(logs[0], "expected an MRCLAM data set, CSV logs or a laser log, found nothing that is known")


def _paths(given: Path | str | Sequence[Path | str] | None) -> tuple[Path, ...]:
    if given is None:
        return ()
    return (Path(given),) if isinstance(given, Path | str) else tuple(Path(p) for p in given)
