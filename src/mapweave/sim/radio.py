"""Ranging radios: every pair in turn, with a bias of its own, and now and then past something that is in the way."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Track

EVERY = 0.2  # [s] from one range of a pair to its next
NOISE = 0.05  # [m] sd of a range
BIAS, BIAS_SD = (
    0.3,
    0.1,
)  # [m] by which ranges are too long: mean and sd over pairs of radios
DETOUR, LEAST_DETOUR = 0.8, 0.3  # [m] how much longer a range is that went round something: mean beyond the least
BLOCKED = 2.0  # [s] for which something is in the way, in the mean


@dataclass(frozen=True, slots=True)
class SimulatedRanges:
    """Of one pair: a, b: its radios; t: (n,) [s]; z: (n,) [m]."""

    a: str
    b: str
    t: Float[np.ndarray, " n"]
    z: Float[np.ndarray, " n"]


def simulated_ranges(
    robots: Mapping[str, Track],
    beacons: Mapping[str, tuple[float, float]],
    noise: float,
    bias: float,
    nlos: float,
    rng: np.random.Generator,
) -> tuple[SimulatedRanges, ...]:
    """What every robot ranged to every other and to every beacon; `nlos`: the share of ranges that are too long."""
    names = [*robots, *beacons]
    pairs = [(a, b) for k, a in enumerate(robots) for b in names[k + 1 :]]
    out = []
    for a, b in pairs:
        track = robots[a]
        t = np.arange(track.t[0] + rng.uniform(0.0, EVERY), track.t[-1], EVERY)
        p = se2.interpolate(t, track.t, track.pose)[:, :2]
        q = se2.interpolate(t, robots[b].t, robots[b].pose)[:, :2] if b in robots else np.array(beacons[b])
        own = bias * (BIAS + BIAS_SD * float(rng.standard_normal()))
        z = np.hypot(*(p - q).T) + own + noise * NOISE * rng.standard_normal(len(t))
        detour = LEAST_DETOUR + DETOUR * rng.exponential(size=len(t))
        out.append(SimulatedRanges(a, b, t, np.maximum(z + _blocked(len(t), nlos, rng) * detour, 0.01)))
    return tuple(out)


def _blocked(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """Whether something is in the way, (n,): for a while each time, `share` of the time in all."""
    leave = EVERY / BLOCKED
    enter = leave * share / max(1.0 - share, leave)
    drawn, now, out = rng.random(n), rng.random() < share, np.zeros(n, bool)
    for k in range(n):
        out[k] = now
        now = drawn[k] >= leave if now else drawn[k] < enter
    return out
