"""Robots seen by robots, made ready to be fused: which sightings count, between which frames, and how surely."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.records import Track
from ..maps.local_map import LocalMap
from ..models import robot_sighting
from .relative import FrameSightings


def frame_sightings(
    maps: Sequence[LocalMap],
    frames: Float[np.ndarray, "m 3"],
    *,
    range_sigma: float = 0.1,
    bearing_sigma: float = 0.02,
    every: float = 5.0,
) -> list[FrameSightings]:
    """The sightings between `maps`, as measurements between their frames.

    frames: (m, 3) `T_ref_local`, roughly: only the noise is linearised there. range_sigma [m], bearing_sigma [rad]: of
    one sighting; the uncertainty of both robots' tracks is added. Tracks err slowly, so of the sightings of one robot
    by another only one in `every` seconds is kept, and none outside either track.
    """
    at = {m.robot: k for k, m in enumerate(maps)}
    out = []
    for a, m in enumerate(maps):
        seen = m.robot_sightings
        targets = np.array(seen.target, dtype=object)
        for target in dict.fromkeys(seen.target):
            b = at.get(target)
            if b is None or b == a:
                continue
            rows = np.flatnonzero((targets == target) & _inside(m.track, seen.t) & _inside(maps[b].track, seen.t))
            rows = rows[_spaced(seen.t[rows], every)]
            if len(rows):
                z = np.stack([seen.range[rows], seen.bearing[rows]], axis=-1)
                t = seen.t[rows]
                out.append(_between(a, b, m.track, maps[b].track, frames, t, z, (range_sigma, bearing_sigma)))
    return out


def _between(
    a: int,
    b: int,
    seer: Track,
    seen: Track,
    frames: Float[np.ndarray, "m 3"],
    t: Float[np.ndarray, " s"],
    z: Float[np.ndarray, "s 2"],
    sigma: tuple[float, float],
) -> FrameSightings:
    T_a, T_b = se2.interpolate(t, seer.t, seer.pose), se2.interpolate(t, seen.t, seen.pose)
    n = np.ones((len(t), 1))
    H = robot_sighting.jacobian(n * frames[a], T_a, n * frames[b], T_b)
    R = np.tile(np.diag(np.square(sigma)), (len(t), 1, 1))
    for columns, track in ((slice(3, 6), seer), (slice(9, 12), seen)):
        if track.cov is not None:
            J = H[:, :, columns]
            R = R + J @ track.cov[_nearest(track.t, t)] @ J.swapaxes(1, 2)
    return FrameSightings(a, b, T_a, T_b, z, R)


def _inside(track: Track, t: Float[np.ndarray, " s"]) -> Bool[np.ndarray, " s"]:
    return (t >= track.t[0]) & (t <= track.t[-1]) if len(track.t) else np.zeros(len(t), dtype=bool)


def _spaced(t: Float[np.ndarray, " s"], every: float) -> list[int]:
    kept: list[int] = []
    for i in np.argsort(t, kind="stable"):
        if not kept or t[i] - t[kept[-1]] >= every:
            kept.append(int(i))
    return kept


def _nearest(stamps: Float[np.ndarray, " n"], t: Float[np.ndarray, " s"]) -> np.ndarray:
    right = np.clip(np.searchsorted(stamps, t), 1, max(len(stamps) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(stamps) - 1)
    return np.where(t - stamps[left] <= stamps[right] - t, left, right)
