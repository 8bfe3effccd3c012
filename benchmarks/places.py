"""Any laser log: how far its map is from what is known of it, beside its verdict, whatever was done to the log.

    MAPWEAVE_DATA=.. python benchmarks/places.py [--only WORD]... [--seeds 2]

A row a log, whole or changed (driven backwards, thinned, cut into robots whose starts are hidden, a minute of it gone,
its odometry set back, the robot carried, two buildings in one file), mapped with the defaults. What is known of it: the
relations of Intel, the 139 edges of CSAIL, the poses that a log itself tells (fr-clinic, and those corrected by another
program), the building of Wean Hall as others drew it, and for changed logs the map of the log as it is: distances after
one rigid alignment. Seconds are those of the processor, kernels compiled.
"""

import argparse
import gzip
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import mapweave
from mapweave.core import se2
from mapweave.core.errors import MapweaveError
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.core.truth import Relations
from mapweave.evaluation.trajectory import score_relations
from mapweave.io.landmark_truth import read_relations
from mapweave.io.laser_logs import read_laser
from mapweave.laser.occupancy_mapper import of_grid

DATA = Path(os.environ.get("MAPWEAVE_DATA", "."))
SPREAD = 0.4  # [m] between poses that are aligned by, at least


class Row(NamedTuple):
    """What is printed of one log: what was measured, and its numbers [m]."""

    what: str
    numbers: dict[str, float]
    note: str = ""


Made = Any  # what `mapweave.map` gives
Score = Callable[[Made, Sequence[LaserLog]], Row]


class Case(NamedTuple):
    name: str
    logs: Callable[[int], list[LaserLog]]
    score: Score
    draws: bool = False  # whether another seed gives another log


def carmen(name: str) -> LaserLog:
    return read_laser(DATA / "carmen" / name, "1")


def part(log: LaserLog, first: int, last: int, robot: str = "1") -> LaserLog:
    """Scans `first` to `last` (not in it), with the odometry between them."""
    t = log.scan_t[first:last]
    rows = log.odometry
    if rows is not None:
        keep = (rows.t >= t[0]) & (rows.t <= t[-1])
        rows = Track(rows.t[keep], rows.pose[keep], frame="odom")
    return replace(log, robot=robot, scan_t=t, scans=log.scans[first:last], odometry=rows, log_hash=f"{first}-{last}")


def with_scans(log: LaserLog, keep: np.ndarray) -> LaserLog:
    """The log with these scans alone; its odometry stays."""
    scans = tuple(log.scans[k] for k in keep.tolist())
    return replace(log, scan_t=log.scan_t[keep], scans=scans, log_hash=f"{log.log_hash} {len(keep)}")


def moved(log: LaserLog, first: int, change: Callable[[np.ndarray], np.ndarray]) -> LaserLog:
    """The log whose odometry from scan `first` on is `change`d."""
    t0 = log.scan_t[first]
    scans = [
        s if k < first or s.odometry is None else replace(s, odometry=np.asarray(change(np.asarray(s.odometry))))
        for k, s in enumerate(log.scans)
    ]
    rows = log.odometry
    if rows is not None:
        pose = np.array(rows.pose)
        late = rows.t >= t0
        pose[late] = change(pose[late])
        rows = Track(rows.t, pose, frame="odom")
    return replace(log, scans=tuple(scans), odometry=rows, log_hash=f"{log.log_hash} moved {first}")


def backwards(log: LaserLog) -> LaserLog:
    total = log.scan_t[0] + log.scan_t[-1]
    rows = log.odometry
    if rows is not None:
        rows = Track((total - rows.t)[::-1], rows.pose[::-1], frame="odom")
    return replace(log, scan_t=(total - log.scan_t)[::-1], scans=log.scans[::-1], odometry=rows, log_hash="backwards")


def wean() -> list[LaserLog]:
    """The five runs in Wean Hall."""
    return [read_laser(DATA / "wean" / f"robotdata{k}.log.gz", str(k)) for k in range(1, 6)]


# ---- what is known of a log


def errors_of(name: str, e: np.ndarray, note: str = "") -> Row:
    e = np.asarray(e)
    if not len(e):
        return Row(name, {}, note)
    return Row(name, {"median": float(np.median(e)), "mean": float(e.mean()), "max": float(e.max())}, note)


def whole_track(made: Made, among: Sequence[str] | None = None) -> Track:
    """The poses of all robots of the largest component, in its frame, in order of time."""
    woven = made.components[0]
    t = np.concatenate([track.t for robot, track in woven.tracks.items() if among is None or robot in among])
    pose = np.concatenate([track.pose for robot, track in woven.tracks.items() if among is None or robot in among])
    t, first = np.unique(t, return_index=True)
    return Track(t, pose[first])


def csail_edges() -> Relations:
    stamps: dict[int, float] = {}
    edges = []
    with gzip.open(DATA / "carmen" / "mit-csail.flirt.log.gz", "rt") as lines:
        last = -1
        for line in lines:
            word = line.split()
            if word[0] == "VERTEX2":
                last = int(word[1])
            elif word[0] == "ROBOTLASER1":
                stamps[last] = float(word[-3])
            elif word[0] == "EDGE2" and abs(int(word[1]) - int(word[2])) != 1:
                edges.append((int(word[1]), int(word[2]), *map(float, word[3:6])))
    t1, t2 = (np.array([stamps[int(e[k])] for e in edges]) for k in range(2))
    return Relations(t1, t2, np.array([e[2:5] for e in edges], float))


def by_edges(made: Made, _: Sequence[LaserLog]) -> Row:
    edges, track = csail_edges(), whole_track(made)
    at = [np.abs(track.t[:, None] - t[None]).argmin(axis=0) for t in (edges.t1, edges.t2)]
    e = se2.between(edges.pose, se2.between(track.pose[at[0]], track.pose[at[1]]))
    return errors_of(f"{len(e)} edges", np.hypot(e[:, 0], e[:, 1]))


def by_relations(*, reversed_: bool = False) -> Score:
    def score(made: Made, logs: Sequence[LaserLog]) -> Row:
        known = read_relations(DATA / "carmen" / "intel.relations.gz")
        if reversed_:
            total = logs[0].scan_t[0] + logs[0].scan_t[-1]
            known = Relations(total - known.t1, total - known.t2, known.pose)
        found = score_relations(whole_track(made), known)
        return Row(f"{found.used} relations", {"mean": found.trans_mean, "sd": found.trans_std, "max": found.trans_max})

    return score


def nearest(track: Track, t: np.ndarray) -> np.ndarray:
    return track.pose[np.abs(track.t[:, None] - np.asarray(t)[None]).argmin(axis=0)]


def aligned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of the places a (n, 3) from b after one rigid alignment, and the distance of headings beside."""
    ma, mb = a[:, :2].mean(axis=0), b[:, :2].mean(axis=0)
    H = (a[:, :2] - ma).T @ (b[:, :2] - mb)
    turn = np.arctan2(H[0, 1] - H[1, 0], H[0, 0] + H[1, 1])
    moved_ = (a[:, :2] - ma) @ se2.rotation(turn).T + mb
    return np.hypot(*(moved_ - b[:, :2]).T)


def by_told_poses(made: Made, logs: Sequence[LaserLog]) -> Row:
    """By the poses in the log: distance after alignment, and at the end where the first poses are one."""
    log, track = logs[0], whole_track(made)
    told, own = np.array([s.odometry for s in log.scans]), nearest(track, log.scan_t)
    end = se2.between(se2.between(told[0], told[-1]), se2.between(own[0], own[-1]))
    return errors_of("poses in the log", aligned(own, told), f"end {np.hypot(*end[:2]):.1f} m")


def by_drawing(made: Made, _: Sequence[LaserLog]) -> Row:
    """By the building as others drew it: distances of our walls from theirs under the best rigid alignment."""
    with gzip.open(DATA / "wean" / "wean.dat.gz", "rt") as lines:
        rows = [line.split() for line in lines]
    head = next(k for k, row in enumerate(rows) if row and row[0].startswith("global_map"))
    drawn = np.array([list(map(float, row)) for row in rows[head + 1 :] if row])
    wall = np.argwhere((drawn >= 0.0) & (drawn < 0.3)) * 0.1
    seen = cKDTree(np.argwhere(drawn >= 0.0) * 0.1)
    grid = made.components[0].grid
    seen_there = of_grid(grid, 0.5)
    own = seen_there.centres(np.argwhere(seen_there.occupied))
    tree = cKDTree(wall)
    best = (0.0, 0.0)
    for turn in np.deg2rad(np.arange(0.0, 360.0, 2.0)):
        for flip in (1.0, -1.0):
            at = laid(own * [1.0, flip], wall, turn)
            if at is None:
                continue
            pose = at
            for gate in (2.0, 1.0, 0.5, 0.3, 0.3):
                p = se2.act(pose, own * [1.0, flip])
                d, k = tree.query(p)
                near = d < gate
                if near.sum() < 50:
                    break
                a, b = p[near], wall[k[near]]
                ma, mb = a.mean(axis=0), b.mean(axis=0)
                H = (a - ma).T @ (b - mb)
                turned = np.arctan2(H[0, 1] - H[1, 0], H[0, 0] + H[1, 1])
                step = np.array([*(mb - se2.rotation(turned) @ ma), turned])
                pose = se2.compose(step, pose)
            p = se2.act(pose, own * [1.0, flip])
            inside = seen.query(p)[0] < 0.5
            d = tree.query(p)[0]
            share = float((d < 0.2).mean())
            if share > best[0]:
                best = (share, float(np.median(d[inside])) if inside.any() else 0.0)
    together = " / ".join("+".join(c.robots) for c in made.components)
    return Row("walls drawn by others", {"share in .2 m": best[0], "median": best[1]}, together)


def laid(own: np.ndarray, wall: np.ndarray, turn: float) -> np.ndarray | None:
    """The shift of points turned by `turn` that lays most of them on walls, cells of 0.4 m, by correlation."""
    p = own @ se2.rotation(turn).T
    low = p.min(axis=0)
    size = 512
    a, b = np.zeros((size, size)), np.zeros((size, size))
    ka, kb = ((p - low) / 0.4).astype(int), (wall / 0.4).astype(int)
    if ka.max() >= size // 2 or kb.max() >= size:
        return None
    a[ka[:, 0], ka[:, 1]] = 1.0
    b[kb[:, 0], kb[:, 1]] = 1.0
    c = np.fft.irfft2(np.fft.rfft2(b) * np.conj(np.fft.rfft2(a)), (size, size))
    at = np.array(np.unravel_index(np.argmax(c), c.shape))
    at = np.where(at > size // 2, at - size, at)
    return np.array([*(at * 0.4 - low), turn])


_whole: dict[str, Track] = {}


def by_whole(name: str, read: Callable[[], LaserLog]) -> Score:
    """By the map of the log as it is."""

    def score(made: Made, logs: Sequence[LaserLog]) -> Row:
        if name not in _whole:
            _whole[name] = whole_track(mapweave.map([read()]))
        whole = _whole[name]
        woven = made.components[0]
        t = np.concatenate([log.scan_t for log in logs if log.robot in woven.robots])
        track = whole_track(made)
        e = aligned(nearest(track, t), nearest(whole, t))
        together = " / ".join("+".join(c.robots) for c in made.components)
        return errors_of("the whole log's map", e, together)

    return score


def by_decision(made: Made, _: Sequence[LaserLog]) -> Row:
    return Row("decision", {}, " / ".join("+".join(c.robots) for c in made.components))


# ---- what is done to logs


def cut(log: LaserLog, parts: int, seed: int) -> list[LaserLog]:
    """The log as so many robots, cut at random where each keeps a fifth of an equal share at least."""
    rng, n = np.random.default_rng(seed), len(log.scans)
    while True:
        at = np.sort(rng.integers(1, n, parts - 1))
        ends = [0, *at.tolist(), n]
        if min(np.diff(ends)) > 0.2 * n / parts:
            return [part(log, ends[k], ends[k + 1], str(k + 1)) for k in range(parts)]


def thinned(log: LaserLog, every: int) -> LaserLog:
    return with_scans(log, np.arange(0, len(log.scans), every))


def sparse(log: LaserLog, seed: int) -> list[LaserLog]:
    return cut(thinned(log, 12), 3, seed)


def numbered(logs: Sequence[LaserLog]) -> list[LaserLog]:
    return [replace(log, robot=str(k)) for k, log in enumerate(logs, 1)]


def driving(log: LaserLog, seed: int, seconds: float) -> tuple[int, int]:
    """Scans a to b, so many seconds apart, over which the robot drove more than 5 m."""
    rng = np.random.default_rng(seed)
    pose = np.array([s.odometry for s in log.scans])
    while True:
        a = int(rng.integers(len(log.scans) // 8, 7 * len(log.scans) // 8))
        b = int(np.searchsorted(log.scan_t, log.scan_t[a] + seconds))
        if b < len(log.scans) and np.hypot(*(pose[b] - pose[a])[:2]) > 5.0:
            return a, b


def gap(log: LaserLog, seed: int, seconds: float = 60.0) -> LaserLog:
    a, b = driving(log, seed, seconds)
    return with_scans(log, np.r_[0:a, b : len(log.scans)])


def jump(log: LaserLog, seed: int) -> LaserLog:
    a, _ = driving(log, seed, 60.0)
    return moved(log, a, lambda p: np.asarray(p) + np.array([3.0, 4.0, 0.0]))


def restart(log: LaserLog, seed: int) -> LaserLog:
    a, _ = driving(log, seed, 60.0)
    start = np.asarray(log.scans[a].odometry)
    return moved(log, a, lambda p: se2.between(start, p))


def carried(log: LaserLog, seed: int) -> LaserLog:
    """What was driven for two minutes is gone, wheels and all, and time goes on as if nothing had been."""
    a, b = driving(log, seed, 120.0)
    lost = log.scan_t[b] - log.scan_t[a] - 0.5
    start, there = np.asarray(log.scans[a].odometry), np.asarray(log.scans[b].odometry)
    back = se2.compose(start, se2.inverse(there))
    late = [replace(s, odometry=np.asarray(se2.compose(back, s.odometry))) for s in log.scans[b:]]
    t = np.concatenate([log.scan_t[: a + 1], log.scan_t[b:] - lost])
    rows = log.odometry
    if rows is not None:
        early, end = rows.t <= log.scan_t[a], rows.t >= log.scan_t[b]
        rows = Track(
            np.concatenate([rows.t[early], rows.t[end] - lost]),
            np.concatenate([rows.pose[early], se2.compose(back, rows.pose[end])]),
            frame="odom",
        )
    return replace(
        log,
        scan_t=t,
        scans=(*log.scans[: a + 1], *late),
        odometry=rows,
        source=f"carried {log.scan_t[a]} {lost}",
        log_hash=f"carried {seed}",
    )


def by_whole_carried(made: Made, logs: Sequence[LaserLog]) -> Row:
    """As `by_whole`, of an Intel log that says in `source` from when on how much time is missing."""
    since, lost = map(float, logs[0].source.split()[1:])
    if "intel" not in _whole:
        _whole["intel"] = whole_track(mapweave.map([intel()]))
    t = logs[0].scan_t
    e = aligned(nearest(whole_track(made), t), nearest(_whole["intel"], np.where(t > since, t + lost, t)))
    return errors_of("the whole log's map", e)


def joined(a: LaserLog, b: LaserLog) -> LaserLog:
    """Two logs in one file: the second follows a second after the first, its odometry goes on from there."""
    shift = a.scan_t[-1] + 1.0 - b.scan_t[0]
    here = se2.compose(a.scans[-1].odometry, se2.inverse(b.scans[0].odometry))
    late = tuple(replace(s, odometry=np.asarray(se2.compose(here, s.odometry))) for s in b.scans)
    rows = None
    if a.odometry is not None and b.odometry is not None:
        ra, rb = a.odometry, b.odometry
        keep_a, keep_b = ra.t <= a.scan_t[-1], rb.t >= b.scan_t[0]
        rows = Track(
            np.concatenate([ra.t[keep_a], rb.t[keep_b] + shift]),
            np.concatenate([ra.pose[keep_a], se2.compose(here, rb.pose[keep_b])]),
            frame="odom",
        )
    t = np.concatenate([a.scan_t, b.scan_t + shift])
    return replace(a, scan_t=t, scans=(*a.scans, *late), odometry=rows, log_hash="joined")


def intel() -> LaserLog:
    return carmen("intel.clf.gz")


def csail() -> LaserLog:
    return carmen("mit-csail.clf.gz")


CASES = [
    Case("CSAIL", lambda _: [csail()], by_edges),
    Case("Intel", lambda _: [intel()], by_relations()),
    Case("Intel backwards", lambda _: [backwards(intel())], by_relations(reversed_=True)),
    Case("fr-clinic", lambda _: [carmen("fr-clinic.clf.gz")], by_told_poses),
    Case("freiburg-campus, corrected", lambda _: [carmen("freiburg-campus-corrected.log.gz")], by_told_poses),
    Case("orebro, corrected", lambda _: [carmen("orebro-corrected.log.gz")], by_told_poses),
    Case("Wean Hall, five runs", lambda _: wean(), by_drawing),
    Case(
        "Wean Hall, other order",
        lambda _: [replace(log, robot=str(k)) for k, log in enumerate(wean()[::-1], 1)],
        by_drawing,
    ),
    Case("CSAIL cut in two", lambda s: cut(csail(), 2, s), by_whole("csail", csail), draws=True),
    Case("CSAIL cut in three", lambda s: cut(csail(), 3, s), by_whole("csail", csail), draws=True),
    Case("Intel cut in two", lambda s: cut(intel(), 2, s), by_whole("intel", intel), draws=True),
    Case("Intel cut in three", lambda s: cut(intel(), 3, s), by_whole("intel", intel), draws=True),
    Case(
        "CSAIL, every 12th scan, three", lambda s: cut(thinned(csail(), 12), 3, s), by_whole("csail", csail), draws=True
    ),
    Case(
        "Intel, every 12th scan, three", lambda s: cut(thinned(intel(), 12), 3, s), by_whole("intel", intel), draws=True
    ),
    Case("CSAIL, every fourth scan", lambda _: [thinned(csail(), 4)], by_whole("csail", csail)),
    Case("CSAIL, every eighth scan", lambda _: [thinned(csail(), 8)], by_whole("csail", csail)),
    Case("Intel, every fourth scan", lambda _: [thinned(intel(), 4)], by_whole("intel", intel)),
    Case("CSAIL, 60 s gone", lambda s: [gap(csail(), s)], by_whole("csail", csail), draws=True),
    Case("Intel, 60 s gone", lambda s: [gap(intel(), s)], by_whole("intel", intel), draws=True),
    Case("CSAIL, odometry jumps 5 m", lambda s: [jump(csail(), s)], by_whole("csail", csail), draws=True),
    Case("Intel, odometry jumps 5 m", lambda s: [jump(intel(), s)], by_whole("intel", intel), draws=True),
    Case("Intel, odometry restarts", lambda s: [restart(intel(), s)], by_whole("intel", intel), draws=True),
    Case("Intel, robot carried", lambda s: [carried(intel(), s)], by_whole_carried, draws=True),
    Case("CSAIL, then Intel, in one file", lambda _: [joined(csail(), part(intel(), 0, 2000))], by_decision),
    Case("Intel and CSAIL", lambda _: [intel(), replace(csail(), robot="2")], by_decision),
]


def rows(words: Sequence[str], seeds: int) -> Iterator[tuple[str, ...]]:
    for case in CASES:
        if words and not any(word in case.name for word in words):
            continue
        for seed in range(seeds if case.draws else 1):
            logs = case.logs(seed)
            began = time.process_time()
            try:
                made = mapweave.map(logs)
            except MapweaveError as error:
                yield (case.name, str(seed), "", "", f"refused: {error}", "", f"{time.process_time() - began:.1f}")
                continue
            spent = time.process_time() - began
            row = case.score(made, logs)
            numbers = ", ".join(f"{name} {value:.3f}" for name, value in row.numbers.items())
            codes: dict[str, int] = {}
            for found in made.findings:
                codes[found.code] = codes.get(found.code, 0) + 1
            told = ", ".join(code if n == 1 else f"{code} x{n}" for code, n in codes.items())
            yield (case.name, str(seed), row.what, numbers, row.note, f"{made.verdict}: {told}", f"{spent:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=2)
    args = parser.parse_args()
    for row in [("log", "draw", "known by", "distances [m]", "", "verdict", "CPU [s]"), ("---",) * 7]:
        print("|", " | ".join(row), "|", flush=True)
    for row in rows(args.only, args.seeds):
        print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
