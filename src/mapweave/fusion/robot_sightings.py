"""Robots seen by robots: range and bearing between two local maps, which of them count, and how surely."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.records import Track
from ..landmarks.landmark_map import LocalMap
from ..solve import Factor, Huber

Poses = Float[np.ndarray, "*b 3"]


def predict(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2"]:
    """`[range m, bearing rad]` of the seen robot from the seer; broadcasts over leading axes.

    T_map_a, T_map_b: poses of the two local frames in the map; T_a_seer, T_b_seen: the robots' poses in their own
    local frames when the sighting was made. Bearing CCW from the seer's x, in (-pi, pi].
    """
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    bearing = se2.wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - seer[..., 2])
    return np.stack([np.hypot(d[..., 0], d[..., 1]), bearing], axis=-1)


def innovation(z: Float[np.ndarray, "*b 2"], h: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2"]:
    """`z - h` with the bearing wrapped."""
    e = np.asarray(z - h)
    e[..., 1] = se2.wrap_angle(e[..., 1])
    return e


def by_poses(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2 12"]:
    """Derivatives of `predict` by `[T_map_a, T_a_seer, T_map_b, T_b_seen]`, (..., 2, 12)."""
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    square = np.sum(d * d, axis=-1)[..., None]
    G = np.stack([d / np.sqrt(square), np.stack([-d[..., 1], d[..., 0]], axis=-1) / square], axis=-2)
    H = np.zeros((*d.shape[:-1], 2, 12))
    for sign, at, frame, robot in ((-1.0, 0, T_map_a, seer), (1.0, 6, T_map_b, seen)):
        arm = robot[..., :2] - frame[..., :2]
        turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
        H[..., at : at + 2] = sign * G
        H[..., at + 2] = sign * (G @ turned[..., None])[..., 0]
        H[..., at + 3 : at + 5] = sign * (G @ se2.rotation(frame[..., 2]))
    H[..., 1, 2] -= 1.0
    H[..., 1, 5] -= 1.0
    return H


@dataclass(frozen=True, slots=True)
class FrameSightings:
    """Robot of map `a` saw robot of map `b`, s times: poses of both in their own frames, z = [range, bearing].

    T_a_seer, T_b_seen: (s, 3); z: (s, 2) [m, rad]; R: (s, 2, 2), everything but the frames' own uncertainty.
    """

    a: int
    b: int
    T_a_seer: Float[np.ndarray, "s 3"]
    T_b_seen: Float[np.ndarray, "s 3"]
    z: Float[np.ndarray, "s 2"]
    R: Float[np.ndarray, "s 2 2"]


def sighting_factor(
    s: FrameSightings,
    where_a: Int[np.ndarray, " i"],
    where_b: Int[np.ndarray, " j"],
    scales: tuple[int, int] | None = None,
) -> Factor:
    """The sightings as a least-squares term over the two frames, an outlier bounded.

    where_a, where_b: (3,) the entries of x that hold each frame's pose, or none for the gauge, the identity; scales:
    the entries that say how many times too large each map is. A robot's track is as much too large as its map.
    """
    n = np.ones((len(s.z), 1))
    keep = np.r_[np.arange(len(where_a)), 6 + np.arange(len(where_b))]
    where = np.concatenate([where_a, where_b, np.array(scales or (), dtype=np.intp)]).astype(np.intp)

    def poses(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        T_a, T_b = (x[at] if len(at) else np.zeros(3) for at in (where_a, where_b))
        s_a, s_b = (1.0, 1.0) if scales is None else x[list(scales)]
        return n * T_a, s.T_a_seer / [s_a, s_a, 1.0], n * T_b, s.T_b_seen / [s_b, s_b, 1.0]

    def residual(x: np.ndarray) -> np.ndarray:
        return -innovation(s.z, predict(*poses(x)))

    def jacobian(x: np.ndarray) -> np.ndarray:
        at = poses(x)
        H = by_poses(*at)
        if scales is None:
            return H[:, :, keep]
        by_scale = [
            -(H[:, :, c : c + 2] @ at[k][:, :2, None])[..., 0] / x[scale]
            for c, k, scale in ((3, 1, scales[0]), (9, 3, scales[1]))
        ]
        return np.concatenate([H[:, :, keep], np.stack(by_scale, axis=-1)], axis=-1)

    whiten = np.linalg.inv(np.linalg.cholesky(s.R))
    return Factor(np.tile(where, (len(s.z), 1)), residual, jacobian, 2, whiten, Huber(2.0), "sighting")


def frame_sightings(
    maps: Sequence[LocalMap],
    frames: Float[np.ndarray, "m 3"],
    *,
    range_sigma: float,
    bearing_sigma: float,
    every: float,
) -> list[FrameSightings]:
    """The sightings between `maps`, as measurements between their frames.

    frames: (m, 3) `T_ref_local`, roughly: only the noise is linearised there. range_sigma [m], bearing_sigma [rad]: of
    one sighting, to which the tracks' own uncertainty is added.
    Tracks err slowly, so of the sightings of one robot by another only one in `every` seconds is kept, and none outside
    either track.
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
    H = by_poses(n * frames[a], T_a, n * frames[b], T_b)
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
