"""The Intel log changed in ways nothing was chosen on, mapped by the command line with its defaults.

    MAPWEAVE_DATA=.. python benchmarks/laser_variants.py [--only NAME]... [--share 1.0]

A row a variant: which robots hang together, mean and greatest error on the known relations that both ends of have a
pose for (of robots in one component together), processor seconds, the verdict, findings beyond those of the log itself
by their codes, and for each pair of robots whether they were merged. --share: of the log, from its beginning.
"""

import argparse
import gzip
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.core.truth import Relations
from mapweave.evaluation.trajectory import score_relations
from mapweave.io.landmark_truth import read_relations

NO_RETURN = 81.83  # [m]
USUAL = {"light-unused", "stamps-mixed"}  # findings of the log as it is


@dataclass(frozen=True)
class Row:
    """One line of the log: ranges of a scan, or None of a row of odometry."""

    t: float
    pose: np.ndarray
    ranges: np.ndarray | None
    host: str


Rows = list[Row]


def read(path: Path) -> Rows:
    rows = []
    with gzip.open(path, "rt") as lines:
        for line in lines:
            word = line.split()
            if word and word[0] == "FLASER":
                n = int(word[1])
                tail = word[2 + n :]
                rows.append(Row(float(tail[6]), np.array(tail[3:6], float), np.array(word[2 : 2 + n], float), tail[7]))
            elif word and word[0] == "ODOM":
                rows.append(Row(float(word[7]), np.array(word[1:4], float), None, word[8]))
    return rows


def write(rows: Rows, path: Path) -> Path:
    with path.open("w", encoding="utf-8") as out:
        for row in rows:
            pose, end = " ".join(f"{v:.6f}" for v in row.pose), f"{row.t:.6f} {row.host} 0"
            if row.ranges is None:
                out.write(f"ODOM {pose} 0 0 0 {end}\n")
            else:
                ranges = " ".join(f"{r:.3f}" for r in row.ranges)
                out.write(f"FLASER {len(row.ranges)} {ranges} {pose} {pose} {end}\n")
    return path


def ranges(rows: Rows, change: Callable[[np.ndarray], np.ndarray]) -> Rows:
    return [row if row.ranges is None else replace(row, ranges=change(row.ranges)) for row in rows]


def wheels(rows: Rows, change: Callable[[np.ndarray], np.ndarray]) -> Rows:
    """Every motion between rows, in the order of their stamps, changed."""
    order = np.argsort([row.t for row in rows], kind="stable")
    pose = np.array([rows[k].pose for k in order])
    steps = change(se2.between(pose[:-1], pose[1:]))
    out, at = list(rows), pose[0]
    for k, step in zip(order.tolist(), [np.zeros(3), *steps], strict=True):
        at = np.asarray(se2.compose(at, step))
        out[k] = replace(rows[k], pose=at)
    return out


def backwards(rows: Rows) -> Rows:
    """Driven the other way: the robot rolls back along its way."""
    first, last = min(row.t for row in rows), max(row.t for row in rows)
    return [replace(row, t=first + last - row.t) for row in rows[::-1]]


def mirrored(rows: Rows) -> Rows:
    flipped = [replace(row, pose=row.pose * [1.0, -1.0, -1.0]) for row in rows]
    return ranges(flipped, lambda r: r[::-1])


def thinned(rows: Rows) -> Rows:
    scans = [k for k, row in enumerate(rows) if row.ranges is not None]
    gone = set(scans[1::2])
    return [row for k, row in enumerate(rows) if k not in gone]


def part(rows: Rows, low: float, high: float) -> Rows:
    t = np.array([row.t for row in rows])
    a, b = np.quantile(t, [low, high])
    return [row for row in rows if a <= row.t < b or (high == 1.0 and row.t == b)]


def near(r: np.ndarray) -> np.ndarray:
    return np.where(r < 10.0, r, NO_RETURN)


def noisy(seed: int) -> Callable[[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(seed)
    return lambda r: np.where(rng.random(len(r)) < 0.1, NO_RETURN, r + rng.normal(0.0, 0.02, len(r)))


VARIANTS: dict[str, Callable[[Rows], list[Rows]]] = {
    "as it is": lambda r: [r],
    "backwards": lambda r: [backwards(r)],
    "mirrored": lambda r: [mirrored(r)],
    "every second beam": lambda r: [ranges(r, lambda a: a[::2])],
    "every second scan": lambda r: [thinned(r)],
    "ranges to 10 m": lambda r: [ranges(r, near)],
    "2 cm noise, a tenth lost": lambda r: [ranges(r, noisy(7))],
    "wheels 5 % long": lambda r: [wheels(r, lambda s: s * [1.05, 1.05, 1.0])],
    "turns 2 % wide": lambda r: [wheels(r, lambda s: s * [1.0, 1.0, 1.02])],
    "wheels stand still": lambda r: [wheels(r, lambda s: 0.0 * s)],
    "from the middle on": lambda r: [part(r, 0.5, 1.0)],
    "three robots with gaps": lambda r: [part(r, 0.0, 0.3), part(r, 0.35, 0.65), part(r, 0.7, 1.0)],
    "second half backwards, two robots": lambda r: [part(r, 0.0, 0.5), backwards(part(r, 0.5, 1.0))],
    "the first third twice": lambda r: [part(r, 0.0, 0.33), part(r, 0.0, 0.33)],
    "a third and its mirror image": lambda r: [part(r, 0.0, 0.33), mirrored(part(r, 0.0, 0.33))],
    "a third beside another building": lambda r: [part(r, 0.0, 0.33)],
}
OTHERS = {"a third beside another building": "loop5.log.gz"}


def relations_of(name: str, robots: Sequence[str], rows: Rows, known: Relations) -> Relations:
    """The known relations as they are between poses of these robots of the variant."""
    t = np.array([row.t for row in rows])
    if name == "mirrored" or (name.endswith("mirror image") and list(robots) == ["2"]):
        return Relations(known.t1, known.t2, known.pose * [1.0, -1.0, -1.0])
    if name == "backwards":
        return Relations(t.min() + t.max() - known.t1, t.min() + t.max() - known.t2, known.pose)
    if name.startswith("second half"):
        late = np.array([row.t for row in part(rows, 0.5, 1.0)])

        def turned(s: np.ndarray) -> np.ndarray:
            return np.where(s >= late.min() - 1e-6, late.min() + late.max() - s, s)

        return Relations(turned(known.t1), turned(known.t2), known.pose)
    return known


def track(folder: Path, robots: Sequence[str]) -> Track:
    """All poses of robots that hang together, in order of time."""
    rows = np.concatenate([np.loadtxt(folder / "trajectories" / f"robot{k}.tum", ndmin=2) for k in robots])
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    return Track(rows[:, 0], np.column_stack([rows[:, 1:3], 2.0 * np.arctan2(rows[:, 6], rows[:, 7])]))


def line(*cells: str) -> None:
    """A row of the table."""
    print("|", " | ".join(cells), "|", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=list(VARIANTS), default=[])
    parser.add_argument("--share", type=float, default=1.0)
    args = parser.parse_args()
    carmen = Path(os.environ["MAPWEAVE_DATA"]) / "carmen"
    rows = read(carmen / "intel.clf.gz")
    rows = part(rows, 0.0, args.share) if args.share < 1.0 else rows
    known = read_relations(carmen / "intel.relations.gz")
    line("variant", "components", "relations", "mean [m]", "greatest [m]", "CPU [s]", "verdict, findings, decisions")
    line(*["---"] * 7)
    for name in args.only or VARIANTS:
        with tempfile.TemporaryDirectory() as folder:
            here = Path(folder)
            logs = [write(one, here / f"log{k + 1}.clf") for k, one in enumerate(VARIANTS[name](rows))]
            logs += [carmen / OTHERS[name]] if name in OTHERS else []
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "mapweave", "map", *map(str, logs), "--out", str(here / "out")]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = f"{after.ru_utime - before.ru_utime:.1f}"
            if done.returncode:
                line(
                    name, f"exit {done.returncode}", "", "", "", cpu, done.stderr.strip().replace(f"{here}/", "")[-300:]
                )
                continue
            told = json.loads((here / "out" / "metrics.json").read_text(encoding="utf-8"))
            scores = []
            for k, robots in enumerate(told["components"], 1):
                at = here / "out" if k == 1 else here / "out" / "components" / str(k)
                score = score_relations(track(at, robots), relations_of(name, robots, rows, known))
                scores.append((score.used, score.trans_mean or 0.0, score.trans_max or 0.0))
            codes = Counter(f["code"] for f in told["findings"] if f["code"] not in USUAL)
            said = [
                told["verdict"],
                *(code if n == 1 else f"{code} x{n}" for code, n in codes.items()),
                *(f"{m['a']} and {m['b']}: {m['decision']}, {m['reason']}" for m in told["fusion"]),
            ]
            used, mean, most = (" + ".join(f"{s[k]:{'d' if k == 0 else '.4f'}}" for s in scores) for k in range(3))
            together = " / ".join("+".join(robots) for robots in told["components"])
            line(name, together, used, mean, most, cpu, "; ".join(said))


if __name__ == "__main__":
    main()
