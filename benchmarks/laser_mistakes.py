"""Laser logs handed over with a mistake: how far off the map is, and what is said of it.

    MAPWEAVE_DATA=.. python benchmarks/laser_mistakes.py [--only NAME]... [--office SEED]

A row a mistake, made in a real log (loop5) and in a simulated office before it is read: the mean and the greatest
distance of the scans' places from those in the map of the log as it is, after one rigid alignment, and the warnings and
repairs beyond those of the log as it is (of each warning what stands before its first colon).
"""

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import mapweave
from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan
from mapweave.io.assemble import RawLog, RawScan
from mapweave.io.laser_logs import read_laser
from mapweave.sim.office import simulate_office

Change = Callable[[RawLog], None]


def raw(log: LaserLog) -> RawLog:
    """The log as a reader of a recording would hand it over: scans that look their odometry up by stamps."""

    def scan(t: float, s: Scan) -> RawScan:
        ranges = np.where(s.hit, s.ranges, np.inf)
        return RawScan(t, ranges, None, s.angle_min, s.angle_increment, 0.0, s.range_max, s.T_robot_sensor)

    out = RawLog("1", log.source, "", odometry_from="poses")
    out.scans = [scan(t, s) for t, s in zip(log.scan_t.tolist(), log.scans, strict=True)]
    rows = {t: s.odometry for t, s in zip(log.scan_t.tolist(), log.scans, strict=True)}
    if log.odometry is not None:
        rows |= dict(zip(log.odometry.t.tolist(), log.odometry.pose, strict=True))
    out.odometry = [(t, *np.asarray(rows[t]).tolist()) for t in sorted(rows)]
    return out


def scans(change: Callable[[RawScan], RawScan]) -> Change:
    def made(log: RawLog) -> None:
        log.scans = [change(scan) for scan in log.scans]

    return made


def ranges(change: Callable[[np.ndarray], np.ndarray], far: float = 1.0) -> Change:
    return scans(lambda s: replace(s, ranges=change(s.ranges), range_max=far * s.range_max))


def angles(factor: float) -> Change:
    return scans(lambda s: replace(s, angle_min=factor * s.angle_min, angle_increment=factor * s.angle_increment))


def mounted(degrees: float) -> Change:
    turn = np.array([0.0, 0.0, np.radians(degrees)])
    return scans(lambda s: replace(s, T_robot_sensor=s.T_robot_sensor + turn))


def wheels(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Change:
    """change: stamps and poses of the odometry give other poses."""

    def made(log: RawLog) -> None:
        rows = np.array(log.odometry)
        log.odometry = [tuple(row) for row in np.column_stack([rows[:, 0], change(rows[:, 0], rows[:, 1:])]).tolist()]

    return made


def steps(factor: tuple[float, float, float]) -> Change:
    def change(_: np.ndarray, pose: np.ndarray) -> np.ndarray:
        out = [pose[0]]
        for step in se2.between(pose[:-1], pose[1:]) * factor:
            out.append(np.asarray(se2.compose(out[-1], step)))
        return np.array(out)

    return wheels(change)


def every_second(t: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Odometry that comes once a second and is held until it comes again."""
    first = np.searchsorted(t, np.floor(t - t[0]) + t[0] - 1e-9)
    return np.asarray(pose[np.minimum(first, len(t) - 1)])


def body(s: RawScan) -> RawScan:
    n, seen = len(s.ranges), s.ranges.copy()
    seen[round(0.4 * n) : round(0.57 * n)] = 0.2
    return replace(s, ranges=seen)


def carried(log: RawLog) -> None:
    """The middle third is cut out, while the wheels report no motion."""
    t = np.array([s.t for s in log.scans])
    a, b = t[len(t) // 3], t[2 * len(t) // 3]
    rows = np.array(log.odometry)
    early, late = rows[rows[:, 0] <= a], rows[rows[:, 0] >= b]
    moved = se2.compose(early[-1, 1:], se2.between(late[0, 1:], late[:, 1:]))
    log.odometry = [tuple(row) for row in [*early.tolist(), *np.column_stack([late[:, 0], moved]).tolist()]]
    log.scans = [s for s in log.scans if s.t <= a or s.t >= b]


def stuck(log: RawLog) -> None:
    """A tenth of the log shows one and the same scan."""
    a, b = round(0.45 * len(log.scans)), round(0.55 * len(log.scans))
    log.scans = [replace(s, ranges=log.scans[a].ranges) if a <= k < b else s for k, s in enumerate(log.scans)]


MISTAKES: dict[str, Change] = {
    "ranges times 1.2": ranges(lambda r: 1.2 * r, 1.2),
    "ranges times 0.8": ranges(lambda r: 0.8 * r, 0.8),
    "ranges in millimetres": ranges(lambda r: 1000.0 * r),
    "wheels times 1.2": steps((1.2, 1.2, 1.0)),
    "turns of the wheels times 1.2": steps((1.0, 1.0, 1.2)),
    "wheels that never turn": wheels(lambda _, p: p * [1.0, 1.0, 0.0]),
    "wheels that stand still": wheels(lambda _, p: 0.0 * p + p[0]),
    "headings in degrees": wheels(lambda _, p: np.column_stack([p[:, :2], np.degrees(np.unwrap(p[:, 2]))])),
    "headings of the other sign": wheels(lambda _, p: p * [1.0, 1.0, -1.0]),
    "y of the other sign": wheels(lambda _, p: p * [1.0, -1.0, 1.0]),
    "odometry backwards in time": wheels(lambda _, p: p[::-1]),
    "odometry once a second": wheels(every_second),
    "scans stamped 0.5 s late": scans(lambda s: replace(s, t=s.t + 0.5)),
    "scans stamped 2 s late": scans(lambda s: replace(s, t=s.t + 2.0)),
    "beams mirrored": angles(-1.0),
    "beams 1.1 times as far apart": angles(1.1),
    "beams 1.5 times as far apart": angles(1.5),
    "mounted turned by 10 degrees": mounted(10.0),
    "mounted turned by 90 degrees": mounted(90.0),
    "mounted backwards": mounted(180.0),
    "30 beams on the robot itself": scans(body),
    "no return said as 5 m": ranges(lambda r: np.minimum(r, 5.0)),
    "half the beams without return": ranges(lambda r: np.where(np.arange(len(r)) % 2, r, np.inf)),
    "a scan stuck for a tenth of the log": stuck,
    "carried while the wheels stand": carried,
}


def apart(made: mapweave.LaserResult, right: mapweave.LaserResult) -> tuple[float, float]:
    """Mean and greatest distance [m] of places of scans in two maps, after one rigid alignment."""
    a, b = made.maps[0].scans, right.maps[0].scans
    p = np.column_stack([np.interp(b.t, a.t, a.pose[:, k]) for k in (0, 1)])
    q = b.pose[:, :2]
    U, _, V = np.linalg.svd((p - p.mean(axis=0)).T @ (q - q.mean(axis=0)))
    R = V.T @ np.diag([1.0, np.linalg.det(V.T @ U.T)]) @ U.T
    d = np.hypot(*((p - p.mean(axis=0)) @ R.T + q.mean(axis=0) - q).T)
    return float(d.mean()), float(d.max())


def row(log: LaserLog, change: Change, right: mapweave.LaserResult) -> tuple[str, str, str]:
    held = raw(log)
    change(held)
    try:
        made = mapweave.map([held.finish()])
    except mapweave.MapweaveError as error:
        return "", "", f"refused: {error}"
    one, before = made.maps[0], right.maps[0]
    said = [text.split(":")[0] for text in one.warnings if text not in before.warnings]
    said += [f"{n} x {what}" for what, n in one.dropped.items() if what != "return of something that moves"]
    mean, most = apart(made, right)
    return f"{mean:.2f}", f"{most:.2f}", "; ".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=list(MISTAKES), default=[])
    parser.add_argument("--office", type=int, default=1, help="seed of the simulated office")
    args = parser.parse_args()
    real = read_laser(Path(os.environ["MAPWEAVE_DATA"]) / "carmen" / "loop5.log.gz")
    for name, log in (("loop5", real), ("office", simulate_office(seed=args.office).log)):
        right = mapweave.map([raw(log).finish()])
        if name == "loop5":
            print("| log | mistake | mean [m] | greatest [m] | told |\n| --- | --- | --- | --- | --- |")
        for mistake in args.only or MISTAKES:
            print("|", " | ".join((name, mistake, *row(log, MISTAKES[mistake], right))), "|", flush=True)


if __name__ == "__main__":
    main()
