"""What laser maps leave behind for going on: every robot's trajectory, scans and graph, to the last digit."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..core.errors import DataError, ReaderError
from ..core.findings import Finding, finding_of, unused_of
from ..core.fixes import Fixes
from ..core.names import in_order, robot_name
from ..core.records import Track
from ..core.version import __version__
from ..laser.laser_map import LaserMap, ScanRecords
from ..laser.odometry_calibration import OdometryCalibration
from ..mapping.decisions import Decisions
from .directory import read_json, write_json
from .laser_map import NAME as GRID
from .laser_map import read_grid
from .npz import Spec, read_npz, write_arrays
from .robot_graph import NAME as GRAPH
from .robot_graph import read_robot_graph

VERSION = 3
INDEX = "state.json"
WORDS = ("robot", "method", "feature", "frame", "odometry", "source", "log_hash", "called", "scan_hash")
WANTED: dict[str, Spec] = {
    "words": ("text", (len(WORDS),)),
    "particles": ("whole", ()),
    "dropped": ("text", ("reasons",)),
    "dropped_counts": ("whole", ("reasons",)),
    "t": ("number", ("n",)),
    "pose": ("number", ("n", 3)),
    "cov": ("number", ("n", 3, 3)),
    "scan_t": ("number", ("m",)),
    "scan_pose": ("number", ("m", 3)),
    "host": ("text", ("m",)),
    "innovation": ("number", ("m", 3)),
    "beams": ("whole", ("m",)),
    "matches": ("whole", ("m",)),
    "decision": ("text", ("m",)),
    "n_eff": ("maybe", ("m",)),
    "resampled": ("whole", ("m",)),
}
MAYBE: dict[str, Spec] = {
    "findings": ("text", ("findings",)),
    "unused": ("text", ("unused",)),
    "warnings": ("text", ("warnings",)),  # of an earlier version
    "dead_t": ("number", ("d",)),
    "dead_pose": ("number", ("d", 3)),
    "information": ("number", ("m", 3, 3)),
    "odometry_calibration": ("number", (41,)),
    "fixes": ("number", ("fixes", 4)),
    "fixes_cov": ("maybe", ("fixes", 2, 2)),
    "fixes_antenna": ("number", (2,)),
    "fixes_words": ("text", (2,)),
    "fixes_dropped": ("text", ("fixes_reasons",)),
    "fixes_dropped_counts": ("whole", ("fixes_reasons",)),
}
T = TypeVar("T")
AGAIN = "map its logs again with --method graph"


@dataclass(frozen=True, slots=True)
class LaserState:
    """maps: every robot's own, in its own frame; starts: robot -> x, y, theta[, sigma] that were told of it; said: what
    somebody decided on them, which is not in `maps` then.
    """

    maps: tuple[LaserMap, ...]
    starts: Mapping[str, tuple[float, ...]]
    said: Decisions | None = None


def write_laser_states(folder: Path, maps: Sequence[LaserMap], starts: Mapping[str, Sequence[float]]) -> None:
    """`folder/state` holds, of each robot, what `local/robotK` does not: with both `read_laser_states` gives `maps`.

    Its index tells the SHA-256 of every file that is read: the robots' own in `local` have to be written before.
    """
    files: dict[str, str] = {}
    for laser_map in maps:
        parts = _files(laser_map.robot)
        _write(folder / parts[0], laser_map)
        files |= {part.as_posix(): _hash(folder / part) for part in parts}
    start_lists = {robot: list(numbers) for robot, numbers in starts.items()}
    held = {
        "version": __version__,
        "state": VERSION,
        "robots": [m.robot for m in maps],
        "starts": start_lists,
        "files": files,
    }
    write_json(folder / "state" / INDEX, held)


def read_laser_states(folder: Path) -> LaserState:
    """What `write_laser_states` and the robots' own folders in `folder` hold, as it was written.

    Raises ReaderError for a folder that holds no result, and for state that is damaged or of another version; DataError
    for a result that cannot go on: of landmarks, or of a laser method without a graph.
    """
    if not folder.is_dir():
        raise ReaderError(folder, "no such folder")
    index = folder / "state" / INDEX
    if not index.is_file():
        raise DataError(f"{folder}: {why_no_state(folder)}")
    state = read_json(index)
    if state.get("state") != VERSION:
        raise ReaderError(
            index,
            f"expected state of version {VERSION}, found {state.get('state')!r}, which mapweave {state.get('version')} "
            f"wrote: {AGAIN}",
        )
    robots = state.get("robots")
    if not isinstance(robots, list) or not robots or not all(isinstance(r, str) for r in robots):
        raise ReaderError(index, "expected the names of its robots, found none")
    starts = state.get("starts")
    if not isinstance(starts, dict) or not all(_is_start(numbers) for numbers in starts.values()):
        raise ReaderError(index, "expected starts of robots as lists of 3 or 4 numbers, found something else")
    files = state.get("files")
    if not isinstance(files, dict):
        raise ReaderError(index, "expected the hashes of its files, found none")
    for robot in robots:
        _check(folder, index, robot, files)
    given = {robot: tuple(map(float, numbers)) for robot, numbers in starts.items()}
    return LaserState(tuple(_read(folder, robot) for robot in robots), given)


def _files(robot: str) -> tuple[Path, Path, Path]:
    """What a robot is read from: its state, its graph and its grid."""
    name = robot_name(robot)
    return Path("state") / f"{name}.npz", Path("local") / name / GRAPH, Path("local") / name / GRID


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _check(folder: Path, index: Path, robot: str, files: Mapping[str, object]) -> None:
    """Raises ReaderError for a file that is missing or is not the one that the index tells of."""
    for part in _files(robot):
        path = folder / part
        if part.is_absolute() or ".." in part.parts:
            raise ReaderError(index, f"expected names of robots, found {robot!r}")
        if not path.is_file():
            raise ReaderError(path, "no such file: the result is not whole")
        if files.get(part.as_posix()) != _hash(path):
            raise ReaderError(path, f"it is not the file that {INDEX} tells of: damaged, or of another result")


def _is_start(numbers: object) -> bool:
    return isinstance(numbers, list) and len(numbers) in {3, 4} and all(isinstance(n, int | float) for n in numbers)


def why_no_state(folder: Path) -> str:
    """What a folder without state is, and what to do."""
    if not (folder / "metrics.json").is_file():
        return "expected a result of `mapweave map`, found no metrics.json"
    scanned = any((folder / "local").rglob(GRID))
    if (folder / "landmarks.csv").is_file() or any((folder / "local").rglob("local_map.json")):
        return f"expected a result of laser logs, found one of {'a mixed team' if scanned else 'landmarks'}"
    if scanned and any((folder / "local").rglob(GRAPH)):
        return "it holds no state/: the result is not whole, copy all of it"
    if scanned:
        return f"the method that made it keeps no graph of keyframes: {AGAIN}"
    return "expected a result of laser logs, found something else"


def holds_state(folder: Path) -> bool:
    """Whether `read_laser_states` would try."""
    return (folder / "state" / INDEX).is_file()


def laser_homes(folder: Path) -> list[Path]:
    """The folders of the robots of a laser result, whatever method made it."""
    return sorted((p.parent for p in (folder / "local").rglob(GRID)), key=lambda p: in_order(p.as_posix()))


def _write(path: Path, laser_map: LaserMap) -> None:
    track, scans, dead = laser_map.track, laser_map.scans, laser_map.dead_reckoning
    if laser_map.graph is None or track.cov is None:
        raise DataError(f"robot {laser_map.robot}: the {laser_map.method} method keeps no graph to go on from")
    words = (
        *(laser_map.robot, laser_map.method, laser_map.feature, track.frame, laser_map.odometry),
        *(laser_map.source, laser_map.log_hash, laser_map.called, laser_map.scan_hash),
    )
    held = {
        "words": np.array(words, dtype=np.str_),
        "particles": np.array(laser_map.particles),
        "dropped": np.array(list(laser_map.dropped), dtype=np.str_),
        "dropped_counts": np.array(list(laser_map.dropped.values()), dtype=np.int64),
        "findings": np.array([json.dumps(found.row()) for found in laser_map.findings], dtype=np.str_),
        "unused": np.array([json.dumps(left.row()) for left in laser_map.unused], dtype=np.str_),
        "t": track.t,
        "pose": track.pose,
        "cov": track.cov,
        "scan_t": scans.t,
        "scan_pose": scans.pose,
        "host": np.array(scans.host, dtype=np.str_),
        "innovation": scans.innovation,
        "beams": scans.beams,
        "matches": scans.matches,
        "decision": np.array(scans.decision, dtype=np.str_),
        "n_eff": scans.n_eff,
        "resampled": scans.resampled.astype(np.int64),
    }
    if dead is not None:
        held |= {"dead_t": dead.t, "dead_pose": dead.pose}
    if scans.information is not None:
        held["information"] = scans.information
    if laser_map.odometry_calibration is not None:
        held["odometry_calibration"] = laser_map.odometry_calibration.numbers()
    if (fixes := laser_map.fixes) is not None:
        held |= {
            "fixes": np.column_stack([fixes.t, fixes.place]),
            "fixes_cov": fixes.cov,
            "fixes_antenna": fixes.antenna,
            "fixes_words": np.array([fixes.frame, fixes.topic], dtype=np.str_),
            "fixes_dropped": np.array(list(fixes.dropped), dtype=np.str_),
            "fixes_dropped_counts": np.array(list(fixes.dropped.values()), dtype=np.int64),
        }
    write_arrays(path, held, gaps=("n_eff", "fixes_cov"))


def _read(folder: Path, robot: str) -> LaserMap:
    path = folder / "state" / f"{robot_name(robot)}.npz"
    held = read_npz(path, WANTED, MAYBE, "the state of a laser map")
    said = dict(zip(WORDS, map(str, held["words"]), strict=True))
    home = folder / "local" / robot_name(robot)
    graph = read_robot_graph(home / GRAPH)
    grid, _, _ = read_grid(home / GRID)
    t = held["t"]
    if said["robot"] != robot or graph.robot != robot:
        raise ReaderError(path, f"expected the state of robot {robot}, found that of {said['robot']}")
    if not len(graph) or not len(t) or (np.diff(t) <= 0).any() or not np.isin(graph.t, t).all():
        raise ReaderError(path, "its stamps are not those of the graph, or do not ascend")
    frame = said["frame"]
    scans = ScanRecords(
        held["scan_t"],
        tuple(map(str, held["host"])),
        held["scan_pose"],
        held["innovation"],
        held["beams"],
        held["matches"],
        tuple(map(str, held["decision"])),
        held["n_eff"],
        held["resampled"].astype(bool),
        held.get("information"),
    )
    dead = Track(held["dead_t"], held["dead_pose"], frame="odom") if {"dead_t", "dead_pose"} <= held.keys() else None
    known = held.get("odometry_calibration")
    return LaserMap(
        robot=robot,
        method=said["method"],
        feature=said["feature"],
        track=Track(t, held["pose"], held["cov"], frame),
        grid=replace(grid, frame=frame),
        scans=scans,
        odometry=said["odometry"],
        dead_reckoning=dead,
        calibration=graph.calibration,
        particles=int(held["particles"]),
        source=said["source"],
        log_hash=said["log_hash"],
        dropped=dict(zip(map(str, held["dropped"]), held["dropped_counts"].tolist(), strict=True)),
        findings=_rows(path, held, "findings", finding_of)
        if "findings" in held
        else tuple(Finding("told-before", value=str(text)) for text in held.get("warnings", ())),
        graph=graph,
        called=said["called"],
        scan_hash=said["scan_hash"],
        unused=_rows(path, held, "unused", unused_of),
        fixes=_fixes(held),
        odometry_calibration=None if known is None else OdometryCalibration.from_numbers(known),
    )


def _fixes(held: Mapping[str, np.ndarray]) -> Fixes | None:
    if not all(name in held for name in MAYBE if name.startswith("fixes")):
        return None
    frame, topic = map(str, held["fixes_words"])
    dropped = dict(zip(map(str, held["fixes_dropped"]), held["fixes_dropped_counts"].tolist(), strict=True))
    told = held["fixes"]
    return Fixes(told[:, 0], told[:, 1:], held["fixes_cov"], held["fixes_antenna"], frame, topic, dropped)


def _rows(path: Path, held: Mapping[str, np.ndarray], name: str, read: Callable[[object], T]) -> tuple[T, ...]:
    """The rows under `name`, each a line of JSON that `read` takes; none where an earlier version kept none."""
    try:
        return tuple(read(json.loads(str(row))) for row in held.get(name, ()))
    except ValueError as error:
        raise ReaderError(path, f"{name}: {error}") from None
