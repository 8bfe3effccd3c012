"""Where two frames lie to each other, from what robots in the one saw of points in the other and the other way round.

For a heading that is tried every sighting is linear in the shift: along its ray with a range, across it always. So all
headings are tried, each with its robust shift, and the best is worked out by Gauss-Newton.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.rows import spread
from ..kernels.landmarks.submap import relation_normal
from .config import PlacingConfig

PLACING_HEADINGS = 72  # tried, of a full turn
PLACING_ROUNDS = 8  # of reweighting, a heading
PLACING_MOST = 400  # sightings looked at
PLACING_INLIER = 3.0  # standard deviations within which a sighting agrees
PLACING_LEAST = 4  # sightings that agree,
PLACING_SHARE = 0.45  # and their share of all
PLACING_LEAD = 3.0  # cost by which any other heading must be worse
PLACING_APART = 0.6  # [rad] from which another heading is another one
SURE_THETA = 0.3  # [rad] sd of the turn of a tie, at most
FARTHEST = 1e3  # [m] of a shift that says nothing
LEAST_TOLD = 1e-12  # of what is told best, below which rounding tells it


@dataclass(frozen=True, slots=True)
class MutualSightings:
    """m sightings between frames a and b.

    forward: the observer is in a (its pose: (m, 3)) and the target in b (point: (m, 2)), else the other way round;
    range: (m,) [m], NaN where it is not told; bearing: (m,) [rad]; t: (m,) [s]; what: (m,) the target's name, where a
    name was told.
    """

    forward: Bool[np.ndarray, " m"]
    pose: Float[np.ndarray, "m 3"]
    point: Float[np.ndarray, "m 2"]
    range: Float[np.ndarray, " m"]
    bearing: Float[np.ndarray, " m"]
    t: Float[np.ndarray, " m"]
    what: np.ndarray = field(default_factory=lambda: np.zeros(0, str))

    def __len__(self) -> int:
        return len(self.t)

    def select(self, keep: np.ndarray) -> "MutualSightings":
        columns = (getattr(self, name) for name in self.__slots__)
        return MutualSightings(*(column[keep] if len(column) else column for column in columns))

    @classmethod
    def joined(cls, parts: "list[MutualSightings]") -> "MutualSightings":
        if not parts:
            nothing = np.zeros(0)
            return cls(nothing.astype(bool), np.zeros((0, 3)), np.zeros((0, 2)), nothing, nothing, nothing)
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in cls.__slots__))


@dataclass(frozen=True, slots=True)
class Relation:
    """Frame b lies at `transform` (3,) in a, with covariance `cov` (3, 3) over x, y, theta; cost is robust."""

    transform: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    agree: int
    of: int
    cost: float

    @property
    def spread(self) -> float:
        """One number for how sure it is: the smaller the surer."""
        return float(np.trace(self.cov))


def residuals(z: MutualSightings, T: Float[np.ndarray, "... 3"], cfg: PlacingConfig) -> Float[np.ndarray, "... m 2"]:
    """Errors of range (0 where it is not told) and bearing, in standard deviations, with b at `T` in a."""
    T = np.asarray(T)
    pose_a = np.where(z.forward[:, None], z.pose, se2.compose(T[..., None, :], z.pose))
    point_a = np.where(z.forward[:, None], se2.act(T[..., None, :], z.point), z.point)
    d = point_a - pose_a[..., :2]
    r = np.hypot(d[..., 0], d[..., 1])
    ranged = np.isfinite(z.range)
    sd = np.hypot(cfg.range_floor, cfg.range_share * np.where(ranged, z.range, 1.0))
    e_r = np.where(ranged, (r - np.where(ranged, z.range, 0.0)) / sd, 0.0)
    e_b = se2.wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - pose_a[..., 2] - z.bearing) / cfg.bearing
    return np.stack([e_r, e_b], axis=-1)


def costs(z: MutualSightings, T: Float[np.ndarray, "... 3"], cfg: PlacingConfig) -> Float[np.ndarray, "..."]:
    """Sum of Cauchy costs."""
    return np.asarray(np.log1p(np.square(residuals(z, T, cfg)).sum(axis=-1) / 4.0).sum(axis=-1))


def relate(z: MutualSightings, cfg: PlacingConfig) -> Relation | None:
    """Where frame b lies in a; None where too few sightings agree, or another heading explains them as well."""
    if len(z) < PLACING_LEAST:
        return None
    z = z.select(spread(len(z), PLACING_MOST))
    heading = 2 * np.pi * np.arange(PLACING_HEADINGS) / PLACING_HEADINGS
    T = np.column_stack([_shifts(z, heading, cfg), heading])
    cost = costs(z, T, cfg)
    best = _refined(z, T[int(np.argmin(cost))], cfg)
    if best is None:
        return None
    transform, cov = best
    least = float(costs(z, transform, cfg))
    others = np.abs(se2.wrap_angle(heading - transform[2])) > PLACING_APART
    for rival in T[others][np.argsort(cost[others])[:3]]:
        again = _refined(z, rival, cfg)
        if again is None or np.abs(se2.wrap_angle(again[0][2] - transform[2])) < PLACING_APART:
            continue
        other = float(costs(z, again[0], cfg))
        if other < least - 1e-9:
            (transform, cov), least, other = again, other, least
        if other < least + PLACING_LEAD:
            return None
    agree = int((np.square(residuals(z, transform, cfg)).sum(axis=-1) < PLACING_INLIER**2).sum())
    if agree < max(PLACING_LEAST, PLACING_SHARE * len(z)):
        return None
    return Relation(transform, cov, agree, len(z), least)


def point_seen(z: MutualSightings, cfg: PlacingConfig) -> Float[np.ndarray, "2"] | None:
    """Where the one point lies that all sightings from frame a are of; None where they do not tell."""
    if len(z) < PLACING_LEAST:
        return None
    origin = replace(z, point=np.zeros((len(z), 2)), forward=np.ones(len(z), bool))
    estimate = _refined(origin, np.append(_shifts(origin, np.zeros(1), cfg)[0], 0.0), cfg, turns=False)
    if estimate is None:
        return None
    transform, cov = estimate
    agree = int((np.square(residuals(origin, transform, cfg)).sum(axis=-1) < PLACING_INLIER**2).sum())
    enough = agree >= max(PLACING_LEAST, PLACING_SHARE * len(z))
    return transform[:2] if enough and np.sqrt(np.diag(cov)[:2].max()) < cfg.sure_xy else None


def is_sure(relation: Relation | None, cfg: PlacingConfig) -> bool:
    """Whether a relation is known well enough to be a tie."""
    if relation is None:
        return False
    sd = np.sqrt(np.diag(relation.cov))
    return bool(max(sd[0], sd[1]) < cfg.sure_xy and sd[2] < SURE_THETA)


def _shifts(z: MutualSightings, heading: Float[np.ndarray, " k"], cfg: PlacingConfig) -> Float[np.ndarray, "k 2"]:
    """The robust shift for each heading."""
    R = se2.rotation(heading)
    turned = np.where(z.forward, 0.0, heading[:, None])
    w = z.pose[:, 2] + z.bearing + turned
    ray = np.stack([np.cos(w), np.sin(w)], axis=-1)
    side = np.stack([-ray[..., 1], ray[..., 0]], axis=-1)
    inside = np.where(z.forward[:, None], z.point, z.pose[:, :2])
    rotated = np.einsum("kij,mj->kmi", R, inside)
    known = np.where(z.forward[:, None], z.pose[:, :2], z.point)
    sign = np.where(z.forward, 1.0, -1.0)
    offset = known - rotated
    ranged = np.isfinite(z.range)
    r = np.where(ranged, z.range, 0.0)
    along = np.einsum("kmi,kmi->km", ray, offset) + sign * r
    across = np.einsum("kmi,kmi->km", side, offset)
    sd_r = np.hypot(cfg.range_floor, cfg.range_share * r)
    sd_b = cfg.bearing * np.broadcast_to(np.where(ranged, np.maximum(r, 0.5), 3.0), across.shape)
    w_r = np.broadcast_to(ranged / sd_r**2, along.shape)
    t = np.zeros((len(heading), 2))
    weight = np.ones_like(across)
    for _ in range(PLACING_ROUNDS):
        a, b = weight * w_r, weight / sd_b**2
        A = (ray * a[..., None]).swapaxes(1, 2) @ ray + (side * b[..., None]).swapaxes(1, 2) @ side
        A += np.eye(2) / FARTHEST**2
        g = np.einsum("km,kmi->ki", a * along, ray) + np.einsum("km,kmi->ki", b * across, side)
        t = np.linalg.solve(A, g[..., None])[..., 0]
        e = np.square(np.einsum("kmi,ki->km", ray, t) - along) * w_r
        away = np.einsum("kmi,ki->km", ray, t) - np.einsum("kmi,kmi->km", ray, offset)
        distance = np.where(ranged, np.maximum(r, 0.5), np.maximum(sign * away, 0.5))
        sd_b = cfg.bearing * distance
        e = e + np.square(np.einsum("kmi,ki->km", side, t) - across) / sd_b**2
        weight = 1.0 / (1.0 + e / 4.0)
    return t


def _refined(
    z: MutualSightings, T: Float[np.ndarray, "3"], cfg: PlacingConfig, *, turns: bool = True
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None:
    """The minimum of the robust cost near `T`, and the covariance there; None where something is free."""
    forward, pose, point, distance, bearing = (
        np.ascontiguousarray(column) for column in (z.forward, z.pose, z.point, z.range, z.bearing)
    )

    def normal(T: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost, gradient and information; a heading that does not turn is known to 1 rad."""
        cost, g, H = relation_normal(
            forward, pose, point, distance, bearing, T, cfg.range_floor, cfg.range_share, cfg.bearing
        )
        if not turns:
            g[2] = H[2, :2] = H[:2, 2] = 0.0
            H[2, 2] = 1.0
        return cost, g, H

    T, damping = np.array(T, float), 1e-3
    cost, g, H = normal(T)
    for _ in range(30):
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-9 * np.eye(3), -g)
        tried = T + step
        new, new_g, new_H = normal(tried)
        if new < cost:
            T, gain, cost, damping = tried, cost - new, new, max(0.3 * damping, LEAST_TOLD)
            g, H = new_g, new_H
            if gain < 1e-9 * cost:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    told = np.linalg.eigvalsh(H)
    if told[0] < max(1e-6, LEAST_TOLD * told[-1]):
        return None
    T[2] = se2.wrap_angle(T[2])
    return T, np.linalg.inv(H)
