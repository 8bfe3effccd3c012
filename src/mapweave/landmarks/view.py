"""Where a robot's sensor looked, and how surely what stands there is in its map: evidence of what is not there.

How far and how wide a sensor sees, and how often it sights what it has in view, is read off the robot's own log.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.landmark_log import SightingTable
from ..core.records import Track

EVERY = 1.0  # [s] from one look to the next, at least: sooner, it sees what it saw before
LOOKS = 2000  # at most, spread over the log: bounds the time
RIM = 0.05  # share of sightings on either side that are left out of the view: there a landmark is seen now and then
SUREST = 0.9  # that what was in view ever so often is in the map: some things stand behind others


@dataclass(frozen=True, slots=True)
class View:
    """What a sensor sees: up to `reach` [m], between the bearings `right` and `left` [rad], at a `rate` of looks.

    `left` is not below `right`, so that of a sensor that looks backwards one of them lies beyond half a turn.
    """

    reach: float
    right: float
    left: float
    rate: float

    def looks(self, track: Track, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "l n"]:
        """Which of n points, in the track's frame, each of l looks along it had in view (1) or not (0)."""
        seen = se2.act(se2.inverse(track.pose[_rows(track)])[:, None], points)
        within = self.within(np.hypot(seen[..., 0], seen[..., 1]), np.arctan2(seen[..., 1], seen[..., 0]))
        return np.asarray(within, dtype=float)

    def within(self, far: Float[np.ndarray, "*n"], bearing: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Whether what is so `far` [m] at a `bearing` [rad] is in view."""
        off = np.abs(se2.wrap_angle(bearing - 0.5 * (self.right + self.left)))
        return np.asarray((far <= self.reach) & (off <= 0.5 * (self.left - self.right)))

    def mapped(self, track: Track, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """The probability that landmarks at n points, in the track's frame, are in the map of who drove it."""
        return np.asarray(SUREST * (1 - (1 - self.rate) ** self.looks(track, points).sum(axis=0)))


def _rows(track: Track) -> np.ndarray:
    """The poses at which a look counts: `EVERY` seconds apart, or as many as `LOOKS` leaves."""
    since = track.t - track.t[0]
    every = max(EVERY, float(since[-1]) / LOOKS)
    looks = every * np.arange(int(since[-1] // every) + 1)
    return np.unique(np.searchsorted(since, np.minimum(looks, since[-1])))


def view_of(track: Track, seen: SightingTable, ids: Sequence[str], mean: Float[np.ndarray, "n 2"]) -> View | None:
    """The view of who drove `track`, saw `seen` and put landmarks `ids` at `mean`; None where too little tells it."""
    number = {name: k for k, name in enumerate(ids)}
    which = np.array([number.get(name, -1) for name in seen.ids], dtype=np.intp)[seen.what]
    known = (which >= 0) & np.isfinite(seen.range)
    if len(track.t) < 2 or not known.any():
        return None
    reach = float(np.quantile(seen.range[known], 1 - RIM))
    ahead = float(np.angle(np.exp(1j * seen.bearing[known]).sum()))  # of the sensor, not of the robot
    off = np.quantile(se2.wrap_angle(seen.bearing[known] - ahead), [RIM, 1 - RIM])
    right, left = float(ahead + off[0]), float(ahead + off[1])
    view = View(reach, right, left, 1.0)
    looks = view.looks(track, mean).sum()
    if not looks:
        return None
    inside = known & view.within(seen.range, seen.bearing)
    look = np.searchsorted(track.t[_rows(track)], seen.t[inside], side="right")
    sighted = len(np.unique(look * len(ids) + which[inside]))
    return View(reach, right, left, float(min(sighted / looks, 1.0)))
