"""A robot's local map as files: `local_map.json` for people, `local_map.npz` for numbers; the same bytes each time."""

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError
from ..core.names import in_order
from ..core.records import Track
from ..landmarks.local_map import LocalMap, RobotSightings
from ..landmarks.submap import Submap
from .directory import plain
from .npz import write_npz

FORMAT = 1


def read_local_map(folder: Path) -> LocalMap:
    """The local map saved in `folder`; raises ReaderError when a file is missing, damaged or of another format."""
    told, arrays = _json(folder / "local_map.json"), _arrays(folder / "local_map.npz")
    if told.get("format") != FORMAT:
        raise ReaderError(folder / "local_map.json", f"expected format {FORMAT}, found {told.get('format')}")
    try:
        return _local_map(told, arrays)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise ReaderError(folder, f"expected a whole local map, found one that lacks or mixes up {error}") from None


def read_local_maps(result: Path) -> tuple[LocalMap, ...]:
    """The landmark maps under `result/local/`, in order of robot number; raises ReaderError when there are none."""
    folders = [p.parent for p in (result / "local").glob("*/local_map.json")]
    if not folders:
        raise ReaderError(result, "expected local/robotK/local_map.json, found none")
    return tuple(read_local_map(p) for p in sorted(folders, key=lambda p: in_order(p.name)))


def _local_map(told: dict[str, Any], arrays: dict[str, np.ndarray]) -> LocalMap:
    names = sorted(told["robot_sightings"])
    target = tuple(names[k] for k in arrays["seen_target"])
    cov = arrays.get("track_cov")
    if cov is not None:
        cov = cov[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    ids = tuple(told["landmarks"])
    return LocalMap(
        robot=told["robot"],
        submap=Submap(told["robot"], arrays["pose"], ids, arrays["mean"], arrays["cov"], told["frame"]),
        track=Track(arrays["track_t"], arrays["track_pose"], cov, told["frame"]),
        sightings={name: int(n) for name, n in told["landmarks"].items()},
        robot_sightings=RobotSightings(arrays["seen_t"], target, arrays["seen_range"], arrays["seen_bearing"]),
        odometry=told["odometry"],
        source=told["source"],
        log_hash=told["log_hash"],
        nis_median=told["nis_median"],
        down_weighted=int(told["down_weighted"]),
        dropped={k: int(n) for k, n in told["dropped"].items()},
        calibration={k: (c["value"], c["sd"]) for k, c in told["calibration"].items()},
        warnings=tuple(told["warnings"]),
    )


def _json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ReaderError(path, f"expected JSON: {error}") from None
    if not isinstance(value, dict):
        raise ReaderError(path, f"expected a JSON object, found {type(value).__name__}")
    return value


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except (ValueError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ReaderError(path, f"expected saved arrays: {error}") from None


def write_local_map(folder: Path, local: LocalMap) -> None:
    """All of `local` in `folder` (made when absent); `read_local_map` gives it back to the bit."""
    folder.mkdir(parents=True, exist_ok=True)
    submap, track, seen = local.submap, local.track, local.robot_sightings
    told = {
        "format": FORMAT,
        "robot": local.robot,
        "frame": submap.frame,
        "source": local.source,
        "log_hash": local.log_hash,
        "odometry": local.odometry,
        "nis_median": local.nis_median,
        "down_weighted": local.down_weighted,
        "dropped": dict(local.dropped),
        "warnings": list(local.warnings),
        "calibration": {name: {"value": v, "sd": sd} for name, (v, sd) in local.calibration.items()},
        "landmarks": {name: local.sightings.get(name, 0) for name in submap.ids},
        "robot_sightings": {name: seen.target.count(name) for name in sorted(set(seen.target))},
        "poses": len(track.t),
    }
    (folder / "local_map.json").write_text(
        json.dumps(plain(told), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    names = sorted(set(seen.target))
    arrays = {
        "pose": submap.pose,
        "mean": submap.mean,
        "cov": submap.cov,
        "track_t": track.t,
        "track_pose": track.pose,
        "seen_t": seen.t,
        "seen_target": np.array([names.index(name) for name in seen.target], dtype=np.int64),
        "seen_range": seen.range,
        "seen_bearing": seen.bearing,
    }
    if track.cov is not None:
        upper = np.triu_indices(3)
        arrays["track_cov"] = track.cov[:, upper[0], upper[1]]  # xx xy xt yy yt tt
    write_npz(folder / "local_map.npz", **arrays)
