"""A robot's local map as files: `local_map.json` for people, `local_map.npz` for numbers; the same bytes each time."""

import json
from pathlib import Path

import numpy as np

from ..landmarks.local_map import LocalMap
from .directory import plain
from .npz import write_npz

FORMAT = 1


def write_local_map(folder: Path, local: LocalMap) -> None:
    """All of `local` in `folder` (made when absent); `readers.local_map` gives it back to the bit."""
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
