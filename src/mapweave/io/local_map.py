"""A robot's local map as files: `local_map.json` for people, `local_map.npz` for numbers; the same bytes each time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError
from ..core.findings import Finding, finding_of
from ..core.records import Track
from ..landmarks.landmark_map import LocalMap, RobotSightings, Submap, View
from .directory import read_json, write_json
from .npz import Spec, read_npz, write_npz

FORMAT = 1
LARGEST_NUMBER = 1e300  # beyond, squares are not finite
ARRAYS: dict[str, Spec] = {
    "pose": ("number", (3,)),
    "mean": ("number", ("landmarks", 2)),
    "cov": ("number", ("state", "state")),
    "track_t": ("number", ("poses",)),
    "track_pose": ("number", ("poses", 3)),
    "seen_t": ("number", ("seen",)),
    "seen_target": ("whole", ("seen",)),
    "seen_range": ("number", ("seen",)),
    "seen_bearing": ("number", ("seen",)),
}


def read_local_map(folder: Path) -> LocalMap:
    """The local map saved in `folder`; raises ReaderError when a file is missing, damaged or of another format."""
    held = _Header(folder / "local_map.json", read_json(folder / "local_map.json"))
    if held.values.get("format") != FORMAT:
        raise ReaderError(held.path, f"expected format {FORMAT}, found {held.values.get('format')!r:.40}")
    arrays = read_npz(folder / "local_map.npz", ARRAYS, {"track_cov": ("number", ("poses", 6))})
    sightings, seen = held.counts("landmarks"), held.counts("robot_sightings")
    ids, names, target = tuple(sightings), sorted(seen), arrays["seen_target"]
    if arrays["mean"].shape[0] != len(ids) or arrays["cov"].shape[0] != 3 + 2 * len(ids):
        raise ReaderError(held.path, f"expected {len(arrays['mean'])} landmarks as in local_map.npz, found {len(ids)}")
    if len(target) and not 0 <= target.min() <= target.max() < len(names):
        raise ReaderError(held.path, f"expected as many robots as local_map.npz holds, found {len(names)}")
    if not (np.diff(arrays["track_t"]) > 0).all():
        raise ReaderError(folder / "local_map.npz", "track_t: expected stamps that ascend strictly")
    cov = arrays.get("track_cov")
    if cov is not None:
        cov = cov[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    robot, frame = held.text("robot"), held.text("frame")
    return LocalMap(
        robot=robot,
        submap=Submap(robot, arrays["pose"], ids, arrays["mean"], arrays["cov"], frame),
        track=Track(arrays["track_t"], arrays["track_pose"], cov, frame),
        sightings=sightings,
        robot_sightings=RobotSightings(
            arrays["seen_t"], tuple(names[i] for i in target.tolist()), arrays["seen_range"], arrays["seen_bearing"]
        ),
        odometry=held.text("odometry"),
        source=held.text("source"),
        log_hash=held.text("log_hash"),
        nis_median=held.number("nis_median"),
        down_weighted=held.count("down_weighted"),
        dropped=held.counts("dropped"),
        calibration=held.calibration(),
        findings=held.findings(),
        first_seen=held.stamps("first_seen", ids),
        view=held.view() if len(arrays["track_t"]) else None,
    )


@dataclass(frozen=True, slots=True)
class _Header:
    """The JSON beside the arrays; every value is checked when it is asked for, and an error names it."""

    path: Path
    values: dict[str, Any]

    def text(self, name: str) -> str:
        value = self.values.get(name)
        if not isinstance(value, str) or not value.isprintable():
            raise self._wrong(name, "text", value)
        return value

    def number(self, name: str) -> float | None:
        value = self.values.get(name)
        if value is not None and not _is_number(value):
            raise self._wrong(name, "a number or null", value)
        return None if value is None else float(value)

    def count(self, name: str) -> int:
        value: Any = self.values.get(name)
        if not _is_count(value):
            raise self._wrong(name, "a whole number", value)
        return int(value)

    def counts(self, name: str) -> dict[str, int]:
        value = self.values.get(name)
        if not isinstance(value, dict) or not all(key.isprintable() and _is_count(n) for key, n in value.items()):
            raise self._wrong(name, "names with whole numbers", value)
        return dict(value)

    def stamps(self, name: str, known: tuple[str, ...]) -> dict[str, float]:
        """Landmark -> seconds; empty where an older file does not tell."""
        value = self.values.get(name, {})
        if not isinstance(value, dict) or not all(key in known and _is_number(t) for key, t in value.items()):
            raise self._wrong(name, "landmarks with seconds", value)
        return {key: float(t) for key, t in value.items()}

    def view(self) -> View | None:
        """What its sensor sees; None where the file does not tell."""
        value = self.values.get("view")
        if value is None:
            return None
        names = tuple(View.__slots__)
        if not isinstance(value, dict) or set(value) != set(names) or not all(map(_is_number, value.values())):
            raise self._wrong("view", f"{', '.join(names)} or null", value)
        view = View(*(float(value[name]) for name in names))
        if not (view.reach > 0 and view.right <= view.left and 0 <= view.rate <= 1):
            raise self._wrong("view", "a reach above 0, left not below right, and a rate of 0 to 1", value)
        return view

    def findings(self) -> tuple[Finding, ...]:
        """Those of the file; the sentences that an older file has in their place."""
        if "findings" not in self.values:
            told = self.values.get("warnings")
            if not isinstance(told, list) or not all(isinstance(word, str) for word in told):
                raise self._wrong("findings", "a list of findings", told)
            return tuple(Finding("told-before", value=word) for word in told)
        value = self.values["findings"]
        if not isinstance(value, list):
            raise self._wrong("findings", "a list of findings", value)
        try:
            return tuple(map(finding_of, value))
        except ValueError as error:
            raise ReaderError(self.path, f"findings: {error}") from None

    def calibration(self) -> dict[str, tuple[float, float]]:
        value = self.values.get("calibration")
        pairs = value.items() if isinstance(value, dict) else ()
        good = isinstance(value, dict) and all(isinstance(c, dict) for c in value.values())
        if not good or not all(_is_number(c.get(key)) for _, c in pairs for key in ("value", "sd")):
            raise self._wrong("calibration", "value and sd by name", value)
        return {name: (float(c["value"]), float(c["sd"])) for name, c in pairs}

    def _wrong(self, name: str, expected: str, value: object) -> ReaderError:
        return ReaderError(self.path, f"{name}: expected {expected}, found {value!r:.60}")


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_NUMBER


def write_local_map(folder: Path, local: LocalMap) -> None:
    """All of `local` in `folder` (made when absent); `read_local_map` gives it back to the bit."""
    folder.mkdir(parents=True, exist_ok=True)
    submap, track, seen = local.submap, local.track, local.robot_sightings
    header = {
        "format": FORMAT,
        "robot": local.robot,
        "frame": submap.frame,
        "source": local.source,
        "log_hash": local.log_hash,
        "odometry": local.odometry,
        "nis_median": local.nis_median,
        "down_weighted": local.down_weighted,
        "dropped": dict(local.dropped),
        "findings": [found.row() for found in local.findings],
        "calibration": {name: {"value": v, "sd": sd} for name, (v, sd) in local.calibration.items()},
        "landmarks": {name: local.sightings.get(name, 0) for name in submap.ids},
        "first_seen": {name: local.first_seen[name] for name in submap.ids if name in local.first_seen},
        "view": None if local.view is None else {name: getattr(local.view, name) for name in View.__slots__},
        "robot_sightings": {name: seen.target.count(name) for name in sorted(set(seen.target))},
        "poses": len(track.t),
    }
    write_json(folder / "local_map.json", header)
    names = sorted(set(seen.target))
    arrays: dict[str, Any] = {
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
