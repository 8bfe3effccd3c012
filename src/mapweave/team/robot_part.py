"""What one robot brings into its team's problem: when its pose is estimated, and where that stands among the variables.

A pose is estimated whenever the robot sees or is seen, and so often that nothing long lies between.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Track
from ..laser.robot_graph import RobotGraph
from .commanded_motion import CommandedMotion
from .config import SmoothingConfig

PARAMETERS = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
SPEED, TURN, LAG, BIAS, RANGE = range(len(PARAMETERS))


@dataclass(frozen=True, slots=True)
class Instants:
    """t: (n,) [s] ascending; start: (n, 3) poses to begin with, in the map's frame; track: where those come from.

    gap: (n - 1,) [s] between the instants before and after each step at which the robot saw or was seen; infinite where
    the robot was put down elsewhere in between.
    """

    t: Float[np.ndarray, " n"]
    start: Float[np.ndarray, "n 3"]
    track: Track
    gap: Float[np.ndarray, " m"]

    @property
    def steps(self) -> Int[np.ndarray, " s"]:
        """The instants from which the robot drove to the next."""
        return np.flatnonzero(np.isfinite(self.gap))

    def nearest(self, t: Float[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
        """Which instant is nearest to each of `t`."""
        right = np.clip(np.searchsorted(self.t, t), 1, max(len(self.t) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(self.t) - 1)
        return np.asarray(np.where(t - self.t[left] <= self.t[right] - t, left, right))

    def from_nearest(self, t: Float[np.ndarray, " m"]) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 3"]]:
        """The instant nearest to each of `t`, and the small motion `T_instant_t` from there, as `track` has it."""
        k = self.nearest(t)
        return k, se2.between(self.start[k], se2.interpolate(t, self.track.t, self.track.pose))


def instants_of(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], track: Track, cfg: SmoothingConfig) -> Instants:
    """The instants of `log`'s robot: first and last stamp of every stretch, sightings it made, sightings of it."""
    stretches = _of_stretches(log, seen_at, cfg)
    t = np.concatenate([stamps for stamps, _ in stretches])
    gap = np.concatenate([np.append(steps, np.inf) for _, steps in stretches])[:-1]
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, gap)


def count_instants(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig) -> int:
    """How many `instants_of` gives."""
    kept = [_kept(stretch, seen_at, cfg) for stretch in log.stretches() if len(stretch)]
    return sum(1 + int(_parts(np.diff(t), cfg).sum()) for t in kept)


def _of_stretches(
    log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig
) -> list[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]]:
    return [_of_stretch(stretch, seen_at, cfg) for stretch in log.stretches() if len(stretch)]


def _of_stretch(
    log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    return _with_steps(_kept(log, seen_at, cfg), cfg)


def _kept(log: LandmarkLog, seen_at: Float[np.ndarray, " s"], cfg: SmoothingConfig) -> Float[np.ndarray, " k"]:
    """The first and last stamp of a stretch and those at which it saw or was seen, of near ones the first."""
    first, last = log.span
    inside = seen_at[(seen_at >= first) & (seen_at <= last)]
    t = np.unique(np.concatenate([[first, last], log.sightings.t, log.bearings.t, inside]))
    return _spaced(t, cfg.shortest_step)


def instants_between(
    first: float, last: float, seen: Float[np.ndarray, " s"], track: Track, cfg: SmoothingConfig
) -> Instants:
    """The instants of a stretch of a log: `first` and `last` [s], both kept, and where it saw or was seen between."""
    t = _spaced(np.unique(np.concatenate([[first], seen[(seen > first) & (seen < last)]])), cfg.shortest_step)
    if last > first:
        t = np.append(t[: max(1, int(np.searchsorted(t, last - cfg.shortest_step, side="right")))], last)
    t, gap = _with_steps(t, cfg)
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, gap)


def _with_steps(
    t: Float[np.ndarray, " k"], cfg: SmoothingConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """`t` and so many stamps between that no step is longer than the longest; and the gap each step lies in."""
    gaps = np.diff(t)
    parts = _parts(gaps, cfg)
    more = [np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(t[:-1], t[1:], parts, strict=True) if n > 1]
    return np.sort(np.concatenate([t, *more])), np.repeat(gaps, parts)


def _parts(gaps: Float[np.ndarray, " g"], cfg: SmoothingConfig) -> Int[np.ndarray, " g"]:
    """In how many steps each gap is driven, so that none is longer than the longest."""
    return np.asarray(np.maximum(np.ceil(gaps / cfg.longest_step - 1e-9).astype(int), 1))


def keyframe_instants(t: Float[np.ndarray, " n"], track: Track) -> Instants:
    """The instants of a robot whose scans became keyframes at `t`: between them its scans tell the motion well."""
    return Instants(t, se2.interpolate(t, track.t, track.pose), track, np.diff(t))


def _spaced(t: Float[np.ndarray, " n"], least: float) -> Float[np.ndarray, " k"]:
    """Of stamps nearer than `least` to the one kept before, none."""
    kept = [t[0]]
    for value in t[1:].tolist():
        if value - kept[-1] >= least:
            kept.append(value)
    return np.array(kept)


@dataclass(frozen=True, slots=True)
class RobotPart:
    """What one robot brings: its log, when its pose is estimated, and where that stands among the variables.

    start: entry of its first pose; parameters: entry of its first calibration parameter; motion: None without odometry;
    scans: its keyframes, which are its instants then, or None without a laser.
    """

    log: LandmarkLog
    instants: Instants
    start: int
    parameters: int
    motion: CommandedMotion | None
    scans: RobotGraph | None = None

    @property
    def seen(self) -> SightingTable:
        """All it saw, with and without a range (NaN there)."""
        return all_seen(self.log)

    @property
    def robot(self) -> str:
        return self.log.robot

    def pose_columns(self, k: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
        """The entries of x that hold the poses at the instants `k`."""
        return np.asarray(self.start + 3 * k[:, None] + np.arange(3))


def all_seen(log: LandmarkLog) -> SightingTable:
    """The sightings with a range and, after them, those by bearing alone."""
    with_range, without = log.sightings, log.bearings
    if not len(without):
        return with_range
    if not len(with_range):
        return without
    what = np.concatenate([with_range.what, without.what + len(with_range.ids)])
    t, z, b = (
        np.concatenate([getattr(with_range, name), getattr(without, name)]) for name in ("t", "range", "bearing")
    )
    return SightingTable(t, what, z, b, (*with_range.ids, *without.ids))
