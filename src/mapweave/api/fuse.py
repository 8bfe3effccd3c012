"""`fuse`: saved local maps of several runs become one map."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.config import load
from ..core.errors import DataError, ReaderError, UsageError
from ..core.names import in_order
from ..core.workers import Progress, no_progress, one_blas_thread
from ..fusion.config import FuseConfig
from ..fusion.join import fuse as join_maps
from ..io.directory import check_target
from ..io.local_map import read_local_map
from ..landmarks.landmark_map import LocalMap
from .fuse_laser import are_laser_results, fuse_laser
from .laser_result import LaserResult
from .map_options import paths_of
from .team import TeamResult, Watch, team_result


@one_blas_thread()
def fuse(
    directories: Path | str | Sequence[Path | str],
    out: Path | str | None = None,
    *,
    weights: str | None = None,
    identities: str | None = None,
    truth: Path | str | Sequence[Path | str] = (),
    config: Path | str | None = None,
    seed: int = 0,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> TeamResult | LaserResult:
    """Fuse the local maps of several results into one map; written to `out` if given.

    Robots are called `DIR/robotK`. Every decision (merged or refused) has its reason in the result; the same log given
    twice counts once, and is told.

    Parameters
    ----------
    directories
        Results of `map` or `fuse`, all of landmark logs or all of laser logs (of the graph method).
    out
        The folder to write; an earlier result there is replaced whole.
    weights
        How much each map counts: constant, paper, diagonal, full, full-scaled or naive (full-scaled). Landmarks alone.
    identities
        `known`: equal ids are one landmark, where the places agree; `unknown`: found out from the places (known).
        Landmarks alone.
    truth
        What `evaluate` takes; used for scoring alone.
    config
        A TOML file of settings, as `configuration("fuse")` prints them for landmarks and `configuration("fuse",
        laser=True)` for laser maps (the tables `merge` and `graph.joint` and `resolution`); options here win.
    seed
        Kept in the metrics; the result does not depend on it (0).
    force
        Write into `out` even when something other than a result stands there (False).
    on_progress
        Called as `on_progress(stage, done, total)`.

    Raises
    ------
    ReaderError
        For a result that is missing or damaged.
    DataError
        For one without local maps, and where laser results stand beside others.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.

    Examples
    --------
    >>> team = simulate_landmarks("team", robots=2, landmarks=12, minutes=1.5, seed=8)
    >>> one, two = map("team", "one", robots=["1"]), map("team", "two", robots=["2"])
    >>> fuse(["one", "two"]).maps[0].robots
    ('one/robot1', 'two/robot2')
    """
    given = list(paths_of(directories, "directories"))
    if not given:
        raise UsageError("expected a result of map, found none")
    if out is not None:
        inside = [path for path in given if path.resolve() != Path(out).resolve()]  # a result itself may be replaced
        check_target(Path(out), force=force, reads=(*inside, *paths_of(truth, "truth"), config))
    for folder in given:
        if not folder.is_dir():
            raise ReaderError(folder, "no such folder")
    if are_laser_results(given):
        idle = {"--weights": weights, "--identities": identities}
        if asked := [name for name, value in idle.items() if value is not None]:
            raise UsageError(f"{', '.join(asked)}: only for landmark results, found {given[0]}")
        names, scores = distinct_names(given), paths_of(truth, "truth")
        settings = None if config is None else Path(config)
        woven = fuse_laser(given, names, config=settings, seed=seed, truth=scores, on_progress=on_progress)
        if out is not None:
            woven.write(out, force=force)
        return woven
    cfg = load(FuseConfig, None if config is None else Path(config), {"weights": weights, "identities": identities})
    watch = Watch()
    local: list[LocalMap] = []
    recordings: dict[str, str] = {}
    for k, (path, label) in enumerate(zip(given, distinct_names(given), strict=True)):
        on_progress("reading", k, len(given))
        read = _read_all(path, label)
        recordings |= {m.robot: f"{m.robot.rpartition('/')[0]}:{m.source}" for m in read}
        local += read
    watch.lap("read")
    result = team_result(
        f"One map fused from {', '.join(distinct_names(given))}",
        seed,
        local,
        join_maps(local, cfg, recordings),
        paths_of(truth, "truth"),
        (),
        watch,
    )
    if out is not None:
        result.write(out, force=force)
    return result


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """As much of the end of every path as tells it from the others: `a/run` and `b/run`, else `run`."""
    parts = [path.resolve().parts for path in paths]
    if len(set(parts)) < len(parts):
        twice = next(str(p) for k, p in enumerate(paths) if parts[k] in parts[:k])
        raise UsageError(f"{twice}: given twice")
    deep = 1
    while len({p[-deep:] for p in parts}) < len(parts):
        deep += 1
    return ["/".join(p[-deep:]) for p in parts]


def _read_all(path: Path, label: str) -> list[LocalMap]:
    found = [p.parent for p in (path / "local").rglob("local_map.json")]
    homes = sorted(found, key=lambda p: in_order(p.as_posix()))
    if not homes:
        raise DataError(f"{path}: expected a result with local maps, found none")
    return [_renamed(read_local_map(home), f"{label}/{home.relative_to(path / 'local').as_posix()}") for home in homes]


def _renamed(m: LocalMap, name: str) -> LocalMap:
    fleet = name.removesuffix(m.robot)
    seen = replace(m.robot_sightings, target=tuple(f"{fleet}{target}" for target in m.robot_sightings.target))
    return replace(m, robot=name, submap=replace(m.submap, robot=name), robot_sightings=seen)
