"""Laser logs handed over with a mistake: how far off the map is, its verdict, and what is found.

    MAPWEAVE_DATA=.. python benchmarks/laser_mistakes.py [--log FILE]... [--only NAME]... [--office SEED]...

A row a mistake, made in real logs (loop5) and in simulated offices before they are read: the mean and the greatest
distance of the scans' places from those in the map of the log as it is, after one rigid alignment, the verdict, the
findings' codes and the repairs beyond those of the log as it is. The last lines count: maps wrong by more than 0.5 m
that are called good, and right ones (0.1 m on average) that are not.
"""

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import mapweave
from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan
from mapweave.io.assemble import RawLog, RawScan
from mapweave.io.laser_logs import read_laser
from mapweave.sim.laser_worlds import simulate_office

Change = Callable[[RawLog], None]
WRONG, RIGHT = 0.5, 0.1  # [m]


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
    out.odometry = [(t, *np.asarray(rows[t]).tolist()) for t in sorted(rows) if rows[t] is not None]
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


def stamps(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """change: stamps of scans give others; scans then bear their own poses, as in CARMEN logs."""

    def made(log: RawLog) -> None:
        rows = np.array(log.odometry)
        t = np.array([s.t for s in log.scans])
        poses = rows[np.clip(np.searchsorted(rows[:, 0], t), 0, len(rows) - 1), 1:]
        new = change(t).tolist()
        log.scans = [replace(s, t=u, odometry=pose) for s, u, pose in zip(log.scans, new, poses, strict=True)]
        log.odometry = []

    return made


def gap(seconds: float) -> Change:
    """So many seconds of scans are missing in the middle; the wheels go on."""

    def made(log: RawLog) -> None:
        t = np.array([s.t for s in log.scans])
        middle = 0.5 * (t[0] + t[-1])
        log.scans = [s for s in log.scans if abs(s.t - middle) > seconds / 2]

    return made


def leap(_: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Odometry that leaps by 5 m in the middle."""
    out = pose.copy()
    out[len(out) // 2 :, 0] += 5.0
    return out


def restarted(_: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Odometry that begins at its origin again in the middle."""
    half = len(pose) // 2
    return np.concatenate([pose[:half], se2.between(pose[half], pose[half:])])


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
    "ranges in centimetres": ranges(lambda r: 100.0 * r, 1.0),
    "ranges and their limit in centimetres": ranges(lambda r: 100.0 * r, 100.0),
    "ranges and their limit in millimetres": ranges(lambda r: 1000.0 * r, 1000.0),
    "wheels times 1000": steps((1000.0, 1000.0, 1.0)),
    "wheels times 0.001": steps((0.001, 0.001, 1.0)),
    "stamps all zero": stamps(lambda t: 0.0 * t),
    "stamps rounded to seconds": stamps(np.floor),
    "clock set back by an hour": stamps(lambda t: np.where(t > t[len(t) // 2], t - 3600.0, t)),
    "20 s of scans missing": gap(20.0),
    "60 s of scans missing": gap(60.0),
    "odometry leaps by 5 m": wheels(leap),
    "odometry begins anew": wheels(restarted),
}


def apart(made: mapweave.LaserResult, right: mapweave.LaserResult) -> tuple[float, float]:
    """Mean and greatest distance [m] of places of scans in two maps, after one rigid alignment.

    Where stamps differ, scans are those of the same numbers.
    """
    a, b = made.maps[0].scans, right.maps[0].scans
    if len(a) == len(b):
        p, q = a.pose[:, :2], b.pose[:, :2]
    else:
        q = np.column_stack([np.interp(a.t, b.t, b.pose[:, k]) for k in (0, 1)])
        p = a.pose[:, :2]
    d = np.hypot(*(se2.act(se2.align(p, q), p) - q).T)
    return float(d.mean()), float(d.max())


@dataclass(frozen=True)
class Outcome:
    """mean, most: [m] from the right map, None where the log was refused; told: what was found or left out."""

    verdict: str
    told: str
    mean: float | None = None
    most: float | None = None


def outcome(log: LaserLog, change: Change, right: mapweave.LaserResult) -> Outcome:
    held = raw(log)
    change(held)
    try:
        made = mapweave.map([held.finish()])
    except mapweave.MapweaveError as error:
        return Outcome("refused", str(error).split(": ", 1)[-1])
    before = {f.code for f in right.findings}
    said = [f.code for f in made.findings if f.code not in before]
    said += [f"{n} x {what}" for what, n in made.maps[0].dropped.items() if what != "return of something that moves"]
    return Outcome(made.verdict, "; ".join(said), *apart(made, right))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=list(MISTAKES), default=[])
    parser.add_argument("--log", action="append", type=Path, default=[], help="real logs in place of loop5")
    parser.add_argument("--office", action="append", type=int, default=[], help="seeds of simulated offices (1)")
    args = parser.parse_args()
    real = args.log or [Path(os.environ["MAPWEAVE_DATA"]) / "carmen" / "loop5.log.gz"]
    logs = [(path.name.split(".")[0], read_laser(path)) for path in real]
    logs += [(f"office {seed}", simulate_office(seed=seed).log) for seed in args.office or ([] if args.log else [1])]
    print("| log | mistake | mean [m] | greatest [m] | verdict | found |\n| --- | --- | --- | --- | --- | --- |")
    every: list[Outcome] = []
    for name, log in logs:
        right = mapweave.map([raw(log).finish()])
        print("|", " | ".join((name, "none", "", "", right.verdict, "; ".join(f.code for f in right.findings))), "|")
        for mistake in args.only or MISTAKES:
            o = outcome(log, MISTAKES[mistake], right)
            numbers = ["" if x is None else f"{x:.2f}" for x in (o.mean, o.most)]
            print("|", " | ".join((name, mistake, *numbers, o.verdict, o.told)), "|", flush=True)
            every.append(o)
    wrong = [o for o in every if o.most is not None and o.most > WRONG]
    fine = [o for o in every if o.mean is not None and o.mean <= RIGHT]
    print(f"\n{sum(o.verdict == 'good' for o in wrong)} of {len(wrong)} maps wrong by more than {WRONG} m are good")
    print(f"{sum(o.verdict != 'good' for o in fine)} of {len(fine)} maps within {RIGHT} m on average are not good")


if __name__ == "__main__":
    main()
