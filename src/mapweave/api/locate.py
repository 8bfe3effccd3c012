"""Known places and distances as people write them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import ClassVar, get_args

import numpy as np

from ..core.bearings import BearingTable
from ..core.config import config as configuration
from ..core.config import load
from ..core.errors import DataError, UsageError
from ..core.paths import AnyConfig, checked_arguments, is_path, path_of
from ..core.records import Odometry
from ..core.workers import Progress, no_progress, one_blas_thread
from ..evaluation.swarm import StandingScore, score_moving, score_standing, scored_robots, true_places
from ..io.directory import check_target
from ..io.sightings import SwarmTruth, read_swarm_odometry, read_swarm_truth, read_team_bearings
from ..io.table import Columns, Table, columns_of, table_of
from ..swarm.config import Method, SwarmConfig
from ..swarm.locate import locate as locate_network
from ..swarm.moving.result import SwarmTrack, TrackConfig
from ..swarm.moving.smooth import filtered as follow_filtered
from ..swarm.moving.smooth import smooth, smooth_driving
from ..swarm.network import BearingNetwork
from ..swarm.posterior import chi2_warnings
from ..swarm.result import SwarmEstimate
from .located import Located, Moved, Place, Settings, SwarmInput, is_team_log, prepare, read_truth, standing_swarm


def parse_anchors(words: Sequence[str] | None) -> dict[str, tuple[float, ...]]:
    """`a=0,0` (or three coordinates) each; raises UsageError where one does not parse or a robot stands twice."""
    known: dict[str, tuple[float, ...]] = {}
    for word in words or ():
        name, _, rest = word.rpartition("=")
        numbers = _numbers(rest)
        if not name.strip() or numbers is None or len(numbers) not in {2, 3}:
            raise UsageError(f"--anchor {word}: expected ID=x,y or ID=x,y,z in metres, such as a=0,0")
        if name.strip() in known:
            raise UsageError(f"--anchor {word}: robot {name.strip()} is given twice")
        known[name.strip()] = numbers
    return known


def parse_distances(words: Sequence[str] | None) -> list[tuple[str, str, float]]:
    """`i,j=10` each; raises UsageError where one does not parse or is not positive."""
    apart = []
    for word in words or ():
        pair, _, rest = word.rpartition("=")
        names, numbers = [name.strip() for name in pair.split(",")], _numbers(rest)
        if len(names) != 2 or not all(names) or numbers is None or len(numbers) != 1 or numbers[0] <= 0.0:
            raise UsageError(f"--distance {word}: expected I,J=D with D metres above 0, such as a,b=10")
        if names[0] == names[1]:
            raise UsageError(f"--distance {word}: the two robots are the same")
        apart.append((names[0], names[1], numbers[0]))
    return apart


def _numbers(text: str) -> tuple[float, ...] | None:
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        return None
    return numbers if all(math.isfinite(v) for v in numbers) else None


MANY = 20_000  # robots beyond which covariances are left out unless asked for


@configuration
class LocateConfig:
    """Settings of `locate`: the tables `[swarm]` (all robots), `[motion]` (robots that move) and `[commanded]`.

    commanded: `[motion]` for a team's own log, whose odometry says what was commanded: turns are off by a tenth, a few
    sightings are gross. A `[motion]` that was changed counts there, too.
    """

    POSITIVE: ClassVar[tuple[str, ...]] = (  # numbers that divide
        *("swarm.prior_sigma", "motion.acceleration", "motion.speed", "commanded.acceleration", "commanded.speed"),
    )
    swarm: SwarmConfig = SwarmConfig()
    motion: TrackConfig = TrackConfig()
    commanded: TrackConfig = TrackConfig(
        slip_floor=0.003, slip=0.04, turn_floor=0.005, turn=0.05, scale_w=0.1, kernel=2.0
    )


@checked_arguments
@one_blas_thread()
def locate(
    sightings: Path | str | BearingTable | Columns,
    out: Path | str | None = None,
    *,
    anchors: Mapping[str, Place] | None = None,
    dim: int | None = None,
    sigma: float | str | None = None,
    distances: Sequence[tuple[str, str, float]] = (),
    method: str | None = None,
    axis: bool | None = None,
    odometry: Path | str | Columns | None = None,
    initial: Path | str | Columns | None = None,
    truth: Path | str | Columns | None = None,
    covariance: bool | None = None,
    motion: TrackConfig | None = None,
    config: AnyConfig | None = None,
    until: float | None = None,
    filtered: bool = False,
    seed: int = 0,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> Located | Moved:
    """Find where every robot of a swarm is, from who sees whom in which direction; written to `out` if given.

    Robots that the sightings leave free are named, not guessed; without two anchors the shape alone is found, and what
    is free is told. Stamped sightings of robots that move give `Moved` (a track each), anything else `Located`.

    Parameters
    ----------
    sightings
        A table in memory or its file (CSV, Parquet): observer, target and bearing [rad]; in space azimuth, elevation
        [rad] or bx, by, bz; optional sigma [rad] and t [s]. Or the folder or zip of a landmark log whose robots saw
        each other.
    anchors
        Id -> known position [m].
    dim
        2 or 3 (as the columns say).
    sigma
        Standard deviation of a bearing [rad], or text with its unit as "0.5deg"; wins over the table's own (1 degree
        where neither says it).
    distances
        Known distances as (id, id, metres).
    method
        batch, robust, distributed, ekf, iekf or fej (batch).
    axis
        Whether bearings are against a common axis (found out from mutual sightings).
    odometry
        Velocities of moving robots, a table or its file: t [s], robot, v [m/s], w [rad/s].
    initial
        Places for the filters to start from, a table or its file: id, x, y[, z] [m].
    truth
        Where robots are truly, a table or its file: id, x, y[, z] [m], with t [s] where they move, or the folder or zip
        of a landmark log; used for scoring alone.
    covariance
        Whether covariances are computed (up to 20,000 robots).
    motion
        How robots move, where they do.
    config
        Settings as `configuration("locate")` prints them: a TOML file, its tables as mappings, or an object of
        a configuration class; options here win.
    until
        Use the first so many seconds [s] of stamped sightings only (all).
    filtered
        Of moving robots what was known at each instant, not what all sightings say of it (False).
    seed
        Kept in the metrics; the result does not depend on it (0).

    Raises
    ------
    ReaderError
        For a table that does not parse, with its line or row.
    DataError
        For one that holds no sighting, an anchor that never appears, a truth of other robots.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.

    Examples
    --------
    >>> bearing = [0.0, 3.14159, 0.7854, 2.3562]
    >>> table = {"observer": ["a", "b", "a", "b"], "target": ["b", "a", "c", "c"], "bearing": bearing}
    >>> found = locate(table, anchors={"a": (0.0, 0.0), "b": (2.0, 0.0)}, sigma="1deg")
    >>> [round(v, 2) for v in found.estimate.position[2].tolist()]
    [1.0, 1.0]
    """
    cfg = load(LocateConfig, config)
    method = cfg.swarm.method if method is None else method
    if motion is not None:
        load(LocateConfig, motion)
    elif cfg.motion != TrackConfig():
        motion = cfg.motion
    if method not in get_args(Method):
        raise UsageError(f"--method {method}: expected one of {', '.join(get_args(Method))}")
    check_target(out, force=force, reads=(sightings, odometry, initial, truth, config))
    drives, start, true = (
        None if one is None else _rows(one, name)
        for one, name in ((odometry, "odometry"), (initial, "initial"), (truth, "truth"))
    )
    began = perf_counter()
    on_progress("reading", 0, 1)
    source, log = _source(sightings)
    axis = axis if log is None else False
    known = dict(anchors or {})
    given = prepare(
        source,
        anchors=known,
        dim=dim,
        sigma=sigma,
        distances=distances,
        axis=axis,
        until=until,
    )
    read = perf_counter()
    on_progress("reading", 1, 1)
    on_progress("locating", 0, 1)
    places = None if true is None else read_truth(true)
    settings = Settings(method, seed, {"read": read - began}, places, cfg.swarm)
    if settings.truth is not None and not set(settings.truth.ids) & set(given.table.ids):
        raise DataError(f"{truth if is_path(truth) else 'truth'}: the truth names none of the robots")
    stamped = given.table.t is not None and len(np.unique(given.table.t)) > 1
    if drives is not None and given.table.t is None:
        raise UsageError("--odometry: the sightings bear no time stamps")
    result: Located | Moved
    if drives is not None:
        result = _drive(given, settings, read_swarm_odometry(drives), motion or TrackConfig(), on_progress)
    elif log is not None:
        result = _drive(given, settings, log, motion or cfg.commanded, on_progress)
    elif stamped:
        still = None if motion is not None or filtered else _stood_still(given, settings, covariance=covariance)
        result = still or _move(given, settings, motion, filtered=filtered)
    else:
        result = _stand(given, settings, start, covariance=covariance)
    result = _with_idle_options(
        result, {"--initial": initial is not None, "--filtered": filtered, "--acceleration": motion is not None}
    )
    on_progress("locating", 1, 1)
    if out is not None:
        on_progress("writing", 0, 1)
        result.write(out, force=force)
        on_progress("writing", 1, 1)
    return result


def _with_idle_options(result: Located | Moved, asked: Mapping[str, bool]) -> Located | Moved:
    """`result` with a word about options that mean nothing to robots that stand still, or to those that move."""
    moving = isinstance(result, Moved)
    idle = ("--initial",) if moving else ("--filtered", "--acceleration")
    why = "the robots move" if moving else "the robots stand still"
    warnings = tuple(f"{name} has no effect: {why}" for name in idle if asked[name])
    return replace(result, given=replace(result.given, warnings=(*result.given.warnings, *warnings)))


def _stand(given: SwarmInput, settings: Settings, initial: Path | Table | None, *, covariance: bool | None) -> Located:
    began = perf_counter()
    net = given.network()
    wanted = len(net) <= MANY if covariance is None else covariance
    start = None
    if initial is not None:
        start = true_places(read_swarm_truth(initial), net.ids, net.dim)
        missing = np.flatnonzero(~np.isfinite(start).all(axis=1))
        if len(missing):
            source = initial.path if isinstance(initial, Table) else initial
            raise DataError(f"{source}: no place for robot {net.ids[missing[0]]}")
    estimate = locate_network(net, replace(settings.swarm, method=_method(settings.method), covariance=wanted), start)
    solved = perf_counter()
    settings.timing["solve"] = solved - began
    score = None
    if settings.truth is not None:
        score = _score(net, estimate, settings.truth, bound=wanted)
        settings.timing["score"] = perf_counter() - solved
    return Located(given, settings, net, estimate, score)


def _score(net: BearingNetwork, estimate: SwarmEstimate, truth: SwarmTruth, *, bound: bool) -> StandingScore:
    """`estimate` against `truth`; `bound`: also the Cramer-Rao bound at the truth (as much work as the covariances)."""
    standing = standing_swarm(net, estimate)
    places = true_places(truth, net.ids, net.dim)
    have, use = np.isfinite(places).all(axis=1), scored_robots(standing, places)
    crlb = None
    whole = have[estimate.localisable].all() and use.any()
    if bound and not estimate.gauge and whole and np.any(net.sigma > 0):
        start = np.where(have[:, None], places, estimate.position)
        at_truth = locate_network(net, SwarmConfig(max_iterations=0), start)
        if at_truth.cov is not None:
            crlb = float(np.sqrt(np.trace(at_truth.cov[use], axis1=1, axis2=2).mean()))
    return score_standing(standing, truth, crlb)


def _stood_still(given: SwarmInput, settings: Settings, *, covariance: bool | None) -> Located | None:
    """The answer for robots that stand still, when the stamped sightings agree that they do."""
    located = _stand(given, settings, None, covariance=covariance)
    e = located.estimate
    return None if chi2_warnings(e.chi2, e.dof) else located


def _move(given: SwarmInput, settings: Settings, motion: TrackConfig | None, *, filtered: bool) -> Moved:
    if not given.table.axis:
        raise DataError("robots that move without a common axis need their odometry: --odometry FILE (t,robot,v,w)")
    began = perf_counter()
    follow = follow_filtered if filtered else smooth
    track = follow(given.table, given.anchors, _tuned(motion, settings))
    return _moving_result(given, settings, track, perf_counter() - began)


def _drive(
    given: SwarmInput, settings: Settings, rows: Mapping[str, Odometry], motion: TrackConfig, on_progress: Progress
) -> Moved:
    began = perf_counter()
    by_index = {k: rows[name] for k, name in enumerate(given.table.ids) if name in rows}
    if not by_index:
        raise DataError("the odometry names no robot of the sightings")
    cfg = _tuned(motion, settings)
    track = smooth_driving(given.table, by_index, given.anchors, cfg, on_progress=on_progress)
    return _moving_result(given, settings, track, perf_counter() - began)


def _moving_result(given: SwarmInput, settings: Settings, track: SwarmTrack, seconds: float) -> Moved:
    settings.timing["solve"] = seconds
    if settings.truth is None:
        return Moved(given, settings, track, None, {})
    ids = given.table.ids
    left_out = {ids[k] for k in range(len(ids)) if k in given.anchors or not track.localisable(k)}
    named = {ids[k]: one for k, one in track.tracks.items()}
    score, there = score_moving(named, left_out, track.gauge, settings.truth)
    return Moved(given, settings, track, score, {ids.index(name): q for name, q in there.items()})


def _source(
    sightings: object,
) -> tuple[Path | BearingTable | Table, Mapping[str, Odometry] | None]:
    """The sightings, and the odometry where they come from a team's log, whose robots have axes of their own."""
    if isinstance(sightings, BearingTable):
        return sightings, None
    given = _rows(sightings, "sightings")
    return read_team_bearings(given) if isinstance(given, Path) and is_team_log(given) else (given, None)


def _rows(given: object, name: str) -> Path | Table:
    """The file or the table that was given. name: of the argument."""
    if is_path(given):
        return path_of(given, name)
    return table_of(columns_of(given, name, "a path or columns by name"), name)


def _tuned(motion: TrackConfig | None, settings: Settings) -> TrackConfig:
    cfg = motion or TrackConfig()
    if settings.method in ("batch", "robust"):
        return replace(cfg, kernel=cfg.kernel or 2.0) if settings.method == "robust" else cfg
    raise UsageError(f"--method {settings.method}: robots that move are located with batch or robust")


def _method(name: str) -> Method:
    for known in get_args(Method):
        if name == known:
            return known  # type: ignore[no-any-return]
    raise UsageError(f"--method {name}: not known")
