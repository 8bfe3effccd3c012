"""Whether scans and odometry bear stamps of one clock: the turns that scans tell, laid over those of the wheels.

A scanner's driver that stamps late, or a second computer whose clock is off, gives every scan the odometry of another
moment: straight on that does little, in turns it lays walls crooked. The turns that matching finds come later than
those of the wheels by the lag.
"""

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.records import Track


@config
class LagCheck:
    """Which lags are tried, and when one is a warning."""

    most: float = 3.0  # [s] tried to either side,
    step: float = 0.05  # [s] apart
    turn: float = 0.02  # [rad] from scan to scan, and more: what stands or drives straight tells nothing
    turns: int = 40  # of them at least
    capped: float = 0.1  # [rad] more difference than this counts as this
    parts: int = 8  # of the log, each asked by itself,
    agree: float = 0.75  # share of them that must find the same lag
    within: float = 0.1  # [s] of each other
    gain: float = 0.75  # of the difference without a lag, at most, must remain with it
    least: float = 0.2  # [s] of lag that is told


def stamp_lag(
    t: Float[np.ndarray, " m"], heading: Float[np.ndarray, " m"], odometry: Track | None, cfg: LagCheck
) -> float | None:
    """By how much [s] the stamps of scans lag behind those of odometry, ahead of them if negative; None where unsure.

    t, heading: of the scans as they were matched, headings unwrapped.
    """
    if odometry is None or len(odometry.t) < 2 or len(t) < 2:
        return None
    turned = np.diff(heading)
    told = np.abs(turned) >= cfg.turn
    if told.sum() < cfg.turns:
        return None
    wheels = np.unwrap(odometry.pose[:, 2])
    lags = cfg.step * np.arange(-round(cfg.most / cfg.step), round(cfg.most / cfg.step) + 1)
    by = np.array([np.diff(np.interp(t - lag, odometry.t, wheels))[told] for lag in lags])
    apart = np.minimum(np.abs(turned[told] - by), cfg.capped)
    whole = apart.mean(axis=1)
    best = int(np.argmin(whole))
    own = lags[[int(np.argmin(part.mean(axis=1))) for part in np.array_split(apart, cfg.parts, axis=1)]]
    sure = np.mean(np.abs(own - lags[best]) <= cfg.within + 1e-9) >= cfg.agree
    return float(lags[best]) if sure and whole[best] <= cfg.gain * whole[len(lags) // 2] else None


def lag_told(lag: float | None, cfg: LagCheck) -> tuple[str, ...]:
    """A warning for a lag that matters."""
    if lag is None or abs(lag) < cfg.least - 1e-9:
        return ()
    way = "after" if lag > 0 else "before"
    stamps = f"the scans bear stamps {abs(lag):.2f} s {way} those of the odometry of the same moments"
    return (f"{stamps}: every scan is given the odometry of another moment, and walls may lie wrong after turns",)
