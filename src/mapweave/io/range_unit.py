"""Ranges in another unit than metres show by their size, and in which one by how they change as wheels drive."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core import se2

FAR = 25.0  # [m] that half the returns of few scanners in use exceed,
FARTHEST = 90.0  # [m] and of none
ABOUT = 1.7  # times a unit's factor by which ranges may change with the way, or as little
SHARE = 0.8  # of the ranges ahead that become shorter by less: some see walls along the way
ENOUGH = 20  # scans, and
MOST_SCANS = 200  # that are looked at
PILE = 0.1  # share of values at the very top that stands for no return
AHEAD = 0.35  # [rad] to either side of where the wheels lead
WAY, TURN = (0.1, 1.0), 0.1  # [m] and [rad] by the wheels from one scan to the next looked at: straight on
WAYS = 5  # that must tell
UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "inches": 39.37}  # of which a metre holds so many


@runtime_checkable
class Ranged(Protocol):
    """A scan as a file has it."""

    @property
    def ranges(self) -> np.ndarray: ...
    @property
    def angle_min(self) -> float: ...
    @property
    def angle_increment(self) -> float: ...
    @property
    def T_robot_sensor(self) -> np.ndarray: ...
    @property
    def kept(self) -> bool: ...


def unit_of_ranges(scans: Sequence[Ranged], wheels: Sequence[np.ndarray | None]) -> str | None:
    """In words, in which unit ranges are that are not in metres; None where they may be. wheels: pose at each scan."""
    held = [scan for scan in scans if scan.kept and len(scan.ranges)]
    if len(held) < ENOUGH:
        return None
    some = held[:: max(1, len(held) // MOST_SCANS)]
    seen = np.concatenate([scan.ranges for scan in some])
    seen = seen[np.isfinite(seen) & (seen > 0) & (seen < 1e9)]
    if not len(seen):
        return None
    top = seen >= 0.99 * seen.max()
    seen = seen[~top] if PILE <= top.mean() < 1.0 else seen
    middle = float(np.median(seen))
    if middle <= FAR:
        return None
    ratio = _ratio(scans, wheels)
    told = f"half of the ranges exceed {middle:.4g}"
    if ratio is not None:
        off = {unit: max(ratio / factor, factor / ratio) for unit, factor in UNITS.items()}
        unit = min(off, key=lambda unit: off[unit])
        if off[unit] <= ABOUT:
            return f"the ranges are in {unit}: {told}, and they change by {ratio:.3g} times the way of the wheels"
    return f"the ranges are in centimetres or millimetres: {told}" if middle > FARTHEST else None


def _ratio(scans: Sequence[Ranged], wheels: Sequence[np.ndarray | None]) -> float | None:
    """By how many times the wheels' way the ranges ahead become shorter, in the median; None where too little tells."""
    places: list[tuple[Ranged, np.ndarray]] = []
    for scan, pose in zip(scans, wheels, strict=True):
        if pose is not None and (not places or np.hypot(*(pose - places[-1][1])[:2]) >= WAY[0]):
            places.append((scan, pose))
    ways = [way for (a, p), (b, q) in pairwise(places) if (way := _nearer(a, p, b, q)) is not None]
    ratio = float(np.median(ways)) if len(ways) >= WAYS else 0.0
    return ratio if ratio > 0 else None


def _nearer(a: Ranged, p: np.ndarray, b: Ranged, q: np.ndarray) -> float | None:
    """By how much the ranges ahead became shorter from one scan at `p` to the next at `q`, over the way."""
    if len(a.ranges) != len(b.ranges):
        return None
    step = q - p
    way = float(np.hypot(step[0], step[1]))
    if way > WAY[1] or abs(step[2]) > TURN:
        return None
    lead = float(np.arctan2(step[1], step[0]) - p[2] - a.T_robot_sensor[2])
    off = se2.wrap_angle(a.angle_min + a.angle_increment * np.arange(len(a.ranges)) - lead)
    change = _change(a.ranges, b.ranges, off)
    return None if change is None else change / way


def _change(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], off: Float[np.ndarray, " n"]) -> float | None:
    with np.errstate(invalid="ignore"):
        both = (np.abs(off) <= AHEAD) & np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
        nearer = a[both] - b[both]
    return float(np.quantile(nearer, SHARE)) if both.sum() >= 3 else None
