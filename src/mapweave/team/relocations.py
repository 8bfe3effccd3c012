"""Where in a log the robot was put down elsewhere: places on either side that wheels do not lead from one to the other.

Every few seconds of the log are placed on their own against landmarks that the robot had no part in, or only with one
half of its log. Where places on either side of a moment follow from each other as the wheels say, but not across it, it
was put down elsewhere.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..core import se2
from ..core.config import config
from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from .config import SmoothingConfig
from .placing import Windows, carried_by_wheels, placed_windows
from .relative_frame import Body, Labels, PlacingConfig, residuals


@config
class KidnapConfig:
    """When a robot is looked at more closely, and when it was put down elsewhere."""

    bin: float = 10.0  # [s] of a log in which sightings are compared with the map
    bin_sightings: int = 6  # in one, at least
    bin_share: float = 0.4  # of them that must agree
    bad_bins: int = 2  # that do not, from which a robot is looked at
    bent: float = 0.2  # [m] by which its path differs from its wheels as calibrated, from which it is, within so many
    bent_within: int = 6  # seconds
    window: float = 8.0  # [s] of a log that is placed on its own,
    run: int = 3  # and how many of them follow from each other on either side of a cut;
    long_window: float = 30.0  # [s] of longer ones, for robots that see little,
    long_run: int = 2  # and how many of those
    back: int = 4  # windows back, to one of which the next must follow
    fits: float = 0.5  # [m] by which a place may differ from what wheels say of the one before, [rad] its heading,
    fits_share: float = 0.3  # and as a share of the distance and of the angle
    carried: float = 0.8  # [m] by which it does where the robot was carried, or
    carried_turn: float = 1.2  # [rad] its heading,
    carried_share: float = 0.25  # both beyond that share of all the distance and angle driven in between
    blind: float = 4.0  # [s] without a sighting, from which it is left open when in between it was carried
    landmarks: int = 4  # of a map against which a robot is placed
    most: int = 5  # robots, one after the other


NEXT = 1e-3  # [s] after a stamp that is still of the stretch before


class Relocation(NamedTuple):
    """The robot was put down elsewhere between these stamps [s], which are one where that is known."""

    begin: float
    end: float


def jumps(
    reference: Body,
    log: LandmarkLog,
    labels: Labels,
    cfg: KidnapConfig,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> tuple[Relocation, ...]:
    """The moments across which places in `reference` do not follow from each other, though they do on either side."""
    wheel_track = carried_by_wheels(log, {}, smoothing)
    for length, least in ((cfg.window, cfg.run), (cfg.long_window, cfg.long_run)):
        windowed = replace(placing, window=length)
        windows = placed_windows(reference, log, wheel_track, {log.robot: log}, labels, windowed)
        out = []
        for before, after in pairwise(_runs(windows, wheel_track, least, cfg)):
            i, j = before[-1], after[0]
            if _carried(windows, i, j, wheel_track, cfg):
                out.append(_moment(windows, i, j, wheel_track, placing, cfg.blind))
        if out:
            return tuple(out)
    return ()


def denied(
    moments: Sequence[Relocation],
    reference: Body,
    log: LandmarkLog,
    labels: Labels,
    restless: Collection[str],
    cfg: KidnapConfig,
    placing: PlacingConfig,
    smoothing: SmoothingConfig,
) -> bool:
    """Whether landmarks that are not `restless` place the robot on either side of every moment, and deny it."""
    names = {labels.get(log.robot, {}).get(name, name) for name in restless}
    still = Body({}, {name: place for name, place in reference.landmarks.items() if name not in names})
    if not names or len(still.landmarks) < cfg.landmarks or jumps(still, log, labels, cfg, placing, smoothing):
        return False
    wheel_track = carried_by_wheels(log, {}, smoothing)
    windows = placed_windows(still, log, wheel_track, {log.robot: log}, labels, replace(placing, window=cfg.window))
    placed = [windows.t[k] for run in _runs(windows, wheel_track, cfg.run, cfg) for k in (run[0], run[-1])]
    return bool(placed) and all(min(placed) < m.begin and m.end < max(placed) for m in moments)


def _runs(windows: Windows, wheel_track: Track, least: int, cfg: KidnapConfig) -> list[list[int]]:
    """At least `least` windows that follow from each other; runs that begin inside another are left out."""
    runs: list[list[int]] = []
    for k in range(len(windows.t)):
        near = [run for run in runs if k - run[-1] <= cfg.back]
        fits = [run for run in near if _follows(windows, run[-1], k, wheel_track, cfg.fits, cfg.fits, cfg.fits_share)]
        if fits:
            max(fits, key=len).append(k)
        else:
            runs.append([k])
    solid = [run for run in runs if len(run) >= least]
    ends, out = -1, []
    for run in solid:
        if run[0] > ends:
            out.append(run)
            ends = run[-1]
    return out


def _follows(windows: Windows, i: int, j: int, wheel_track: Track, floor: float, turn: float, share: float) -> bool:
    """Whether window j lies where the wheels lead from window i, give or take."""
    said, miss = _missed(windows, i, j, wheel_track)
    angle = _driven(wheel_track, windows.t[i], windows.t[j])[1]
    near = float(np.hypot(miss[0], miss[1])) < floor + share * float(np.hypot(said[0], said[1]))
    return near and abs(float(miss[2])) < turn + share * angle


def _carried(windows: Windows, i: int, j: int, wheel_track: Track, cfg: KidnapConfig) -> bool:
    """Whether window j lies where no wheels lead from window i, however far off their scales may be.

    What they may err by grows with all that was driven in between, to and fro, and sideways with the angle too, half
    the way on average after the turn: over minutes without a place they tell nothing.
    """
    miss = _missed(windows, i, j, wheel_track)[1]
    way, angle = _driven(wheel_track, windows.t[i], windows.t[j])
    away = float(np.hypot(miss[0], miss[1])) >= cfg.carried + cfg.carried_share * way * (1.0 + 0.5 * angle)
    return away or abs(float(miss[2])) >= cfg.carried_turn + cfg.carried_share * angle


def _missed(windows: Windows, i: int, j: int, wheel_track: Track) -> tuple[np.ndarray, np.ndarray]:
    """The motion that the wheels tell from window i to window j, and where j lies as seen from its end."""
    base = se2.interpolate(windows.t[[i, j]], wheel_track.t, wheel_track.pose)
    said = se2.between(base[0], base[1])
    return said, se2.between(se2.compose(windows.place[i], said), windows.place[j])


def _driven(wheel_track: Track, begin: float, end: float) -> tuple[float, float]:
    """The distance [m] and the angle [rad] that wheels tell, to and fro."""
    inside = wheel_track.pose[(wheel_track.t >= begin) & (wheel_track.t <= end)]
    way = np.hypot(*np.diff(inside[:, :2], axis=0).T)
    return float(way.sum()), float(np.abs(se2.wrap_angle(np.diff(inside[:, 2]))).sum())


def _moment(windows: Windows, i: int, j: int, wheel_track: Track, placing: PlacingConfig, blind: float) -> Relocation:
    """The moment between two windows up to which sightings agree with the one, and from which with the other.

    Where long nothing was seen in between, both ends of that time: nobody knows when in it the robot was carried.
    """
    z = windows.seen.select((windows.seen.t > windows.t[i]) & (windows.seen.t < windows.t[j]))
    left, right = float(windows.t[i]), float(windows.t[j])
    if len(z):
        cost = []
        for k in (i, j):
            base = se2.interpolate(windows.t[[k]], wheel_track.t, wheel_track.pose)[0]
            T = se2.compose(windows.place[k], se2.inverse(base))
            cost.append(np.minimum(np.square(residuals(z, T, placing)).sum(axis=-1), placing.inlier**2))
        total = np.append(0.0, np.cumsum(cost[0])) + np.append(np.cumsum(cost[1][::-1])[::-1], 0.0)
        k = int(np.argmin(total))
        left = float(z.t[k - 1]) if k else left
        right = float(z.t[k]) if k < len(z) else right
    return Relocation(left + NEXT, right) if right - left > blind else Relocation(*[0.5 * (left + right)] * 2)
