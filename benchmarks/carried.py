"""Robots that are carried among rooms that look alike, unseen: what comes of their maps, and what they are called.

python benchmarks/carried.py

Of each drive through a small office a part is left out, scans and wheels and all: the robot was carried meanwhile. A
map is right where the scans after it lie where they were taken, seen from those before it.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
from jaxtyping import Float

import mapweave
from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

SEEDS = 40
SHARES = ((0.45, 0.7), (0.2, 0.5), (0.6, 0.65))  # of the drive, between which the robot was carried
OFFICE = OfficeConfig(rooms=3, visited=4)
RIGHT = 0.5  # [m] by which nearly all scans err at most
NEARLY = 0.98  # of them: what a scan taken while the robot is set down tells may be anything
KINDS = ("right", "right, doubtful", "wrong, doubtful", "two maps", "wrong, good")


def carried(log: LaserLog, share: tuple[float, float]) -> tuple[LaserLog, Float[np.ndarray, " n"]]:
    """The log without what was driven from `share` to `share` of it, wheels and all; and when each scan truly was."""
    first, last = (int(at * len(log.scans)) for at in share)
    before, after = (np.asarray(log.scans[k].odometry) for k in (first, last))
    back = se2.compose(before, se2.inverse(after))
    lost = log.scan_t[last] - log.scan_t[first] - 0.3
    late = [replace(s, odometry=np.asarray(se2.compose(back, np.asarray(s.odometry)))) for s in log.scans[last:]]
    t = np.concatenate([log.scan_t[: first + 1], log.scan_t[last:] - lost])
    rows = log.odometry
    assert rows is not None  # noqa: S101  (simulated robots have wheels)
    kept = rows.t <= log.scan_t[first]
    spoilt = replace(
        log,
        scan_t=t,
        scans=(*log.scans[: first + 1], *late),
        odometry=Track(rows.t[kept], rows.pose[kept], frame="odom"),
        log_hash=f"carried {share}",
    )
    return spoilt, np.where(t > log.scan_t[first], t + lost, t)


def outcome(seed: int, share: tuple[float, float]) -> str:
    """One of `KINDS`."""
    made = simulate_office(OFFICE, seed)
    dark = replace(made.log, scans=tuple(replace(s, intensities=None) for s in made.log.scans))
    log, t = carried(dark, share)
    result = mapweave.map([log])
    tracks = list(result.maps and result.components[0].tracks.values())
    if len(result.components) > 1:
        return "two maps"
    at = np.concatenate([track.t for track in tracks])
    pose = np.concatenate([track.pose for track in tracks])[np.argsort(at, kind="stable")]
    pose = pose[np.searchsorted(np.sort(at), log.scan_t - 1e-6)]
    true = made.truth.pose[np.abs(made.truth.t[:, None] - t[None]).argmin(axis=0)]
    first = int(share[0] * len(dark.scans))
    origin = se2.align(pose[:first, :2], true[:first, :2])
    off = np.hypot(*(se2.act(origin, pose[:, :2]) - true[:, :2]).T)
    right = float(np.quantile(off, NEARLY)) < RIGHT
    return (
        ("right" if right else "wrong, good")
        if result.verdict == "good"
        else f"{'right' if right else 'wrong'}, doubtful"
    )


def main() -> None:
    print(f"| carried between | {' | '.join(KINDS)} |")
    print(f"|{'---|' * (len(KINDS) + 1)}")
    for share in SHARES:
        counts = Counter(outcome(seed, share) for seed in range(1, SEEDS + 1))
        told = " | ".join(str(counts[kind]) for kind in KINDS)
        print(f"| {share[0]:.0%} and {share[1]:.0%} of the drive | {told} |", flush=True)


if __name__ == "__main__":
    main()
