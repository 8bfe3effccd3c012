"""Logs of buildings nobody tuned on: sparse scans on raw wheels, against the poses that another program corrected.

    python benchmarks/corrected_logs.py FOLDER [--only WORD].. [--cut N].. [--pairs FILE]

FOLDER holds CARMEN logs as GMapping corrected them (`*-corrected.log.gz` and `*.gfs.log.gz` of the Radish collection,
a scan every metre or half radian). Between two scans their odometry is what the wheels told, and at each scan the
correction enters: chained without it, it is the raw odometry again, tens of metres off at the end. A row a log, mapped
with the defaults, whole and with `--cut` given as so many robots whose starts are hidden. Distances are between what
the map and the corrected poses say of scans within 2.5 m of each other, of those of one pass and of several; the
corrected poses themselves are right to about a cell of 5 cm.

`--pairs` tries every pair of pieces, cut in 2, 3 and 5, on each other, and adds one line a pair to FILE: what the
decision rests on and whether it is right, as `merge_trust.py --log` reads it.
"""

import argparse
import gzip
import json
import tempfile
import time
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import mapweave
from mapweave.core import se2
from mapweave.mapping.map_overlap import KeyframeMap, keyframe_map
from mapweave.mapping.merge import merge_maps
from mapweave.mapping.merge_ambiguity import Grounds
from mapweave.mapping.segments import pieces_of

BEAT = 0.1  # [s] between two rows: the stamps of such logs are rounded, and go back
NEAR = 2.5  # [m] between scans whose relative pose is compared,
PASS = 10  # scans apart from which on they are of another pass
RIGHT, RIGHT_TURN = 2.0, 0.12  # [m], [rad] that a merge of two bent maps errs by at most where they meet
CUTS = (2, 3, 5)  # pieces of a log that pairs are made of
STRANGERS = 1500  # pairs of two buildings at most


class Raw(NamedTuple):
    """A log on raw wheels: its lines, which of them are scans, and stamp and corrected pose of each, (n, 4)."""

    name: str
    lines: list[str]
    scans: list[int]
    known: np.ndarray

    def part(self, first: int, last: int) -> str:
        """The lines from scan `first` to before scan `last`."""
        end = len(self.lines) if last >= len(self.scans) else self.scans[last]
        return "\n".join(self.lines[self.scans[first] if first else 0 : end]) + "\n"

    def cut(self, many: int) -> list[str]:
        at = np.linspace(0, len(self.scans), many + 1).astype(int).tolist()
        return [self.part(first, last) for first, last in pairwise(at)]


def raw_log(path: Path) -> Raw:
    """The log with its correction undone."""
    lines, scans, known = [], [], []
    raw, before, corrected = np.zeros(3), None, False
    with gzip.open(path, "rt", encoding="latin-1") as text:
        for row in text:
            words = row.split()
            if not words or words[0] not in {"ODOM", "FLASER"}:
                continue
            stamp = f"{BEAT * (len(lines) + 1):.1f}"
            returns = [] if words[0] == "ODOM" else words[2 : 2 + int(words[1])]
            at = 1 if not returns else 2 + len(returns)
            pose = np.array([float(word) for word in words[at : at + 3]])
            if before is not None and not returns and not corrected:
                raw = np.asarray(se2.compose(raw, se2.between(before, pose)))
            before, corrected = pose, bool(returns)
            told = " ".join(f"{x:.6f}" for x in raw)
            if returns:
                scans.append(len(lines))
                known.append([float(stamp), *pose])
                lines.append(f"FLASER {len(returns)} {' '.join(returns)} {told} {told} {stamp} x {stamp}")
            else:
                lines.append(f"ODOM {told} 0 0 0 {stamp} x {stamp}")
    return Raw(path.name.split("-corrected")[0].split(".")[0], lines, scans, np.array(known))


def mapped(texts: list[str]) -> tuple[Any, float]:
    """The map of robots that these logs are of, and CPU seconds."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"robot{k}.log" for k in range(1, len(texts) + 1)]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text, encoding="utf-8")
        started = time.process_time()
        made = mapweave.map([str(path) for path in paths])
        return made, time.process_time() - started


def distances(made: Any, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[m] between what the map and the corrected poses say of near scans: of one pass, of several.

    Scans in another component say nothing of each other.
    """
    one, several = [], []
    for woven in made.components:
        tracks = woven.tracks.values()
        t, pose = np.concatenate([x.t for x in tracks]), np.concatenate([x.pose for x in tracks])
        order = np.argsort(t, kind="stable")
        t, pose = t[order], pose[order]
        at = np.clip(np.searchsorted(t, known[:, 0] - 0.5 * BEAT), 0, len(t) - 1)
        there = np.flatnonzero(np.abs(t[at] - known[:, 0]) < 0.5 * BEAT)
        pairs = cKDTree(known[there, 1:3]).query_pairs(NEAR, output_type="ndarray")
        told = se2.between(known[there[pairs[:, 0]], 1:], known[there[pairs[:, 1]], 1:])
        ours = se2.between(pose[at[there[pairs[:, 0]]]], pose[at[there[pairs[:, 1]]]])
        e = np.hypot(*(ours - told)[:, :2].T)
        again = np.abs(there[pairs[:, 0]] - there[pairs[:, 1]]) > PASS
        one.append(e[~again])
        several.append(e[again])
    return np.concatenate(one), np.concatenate(several)


def told_of(e: np.ndarray) -> str:
    return " / ".join(f"{x:.3f}" for x in np.percentile(e, [50, 95, 100])) if len(e) else "-"


def row(raw: Raw, cut: int) -> str:
    made, cpu = mapped(raw.cut(cut))
    one, several = distances(made, raw.known)
    parts = " / ".join("+".join(woven.tracks) for woven in made.components)
    codes = sorted({f.code for f in made.findings} - {"light-unused"})
    way = np.hypot(*np.diff(raw.known[:, 1:3], axis=0).T).sum()
    name = raw.name if cut == 1 else f"{raw.name}, cut in {cut}"
    numbers = f"{len(raw.scans)} | {way:.0f} | {told_of(one)} | {told_of(several)}"
    return f"| {name} | {numbers} | {parts} | {made.verdict}: {', '.join(codes) or 'nothing'} | {cpu:.1f} |"


class PieceMap(NamedTuple):
    """A piece of a log mapped alone, and the corrected poses of its keyframes."""

    building: str
    cut: int
    number: int
    map: KeyframeMap
    known: np.ndarray


def piece_maps(raw: Raw) -> list[PieceMap]:
    out = []
    for cut in CUTS:
        for number, text in enumerate(raw.cut(cut)):
            for single in mapped([text])[0].maps:
                at = np.argmin(np.abs(raw.known[None, :, 0] - np.asarray(single.graph.t)[:, None]), axis=1)
                for rows in pieces_of(single.graph):
                    made = keyframe_map(single.graph, keep=rows)
                    out.append(PieceMap(raw.name, cut, number, made, raw.known[at[rows], 1:]))
    return [piece for piece in out if len(piece.map.submaps) > 2]


def lies_right(transform: np.ndarray | None, a: PieceMap, b: PieceMap) -> bool:
    """Whether T_a_b holds where the pieces come nearest to each other."""
    if transform is None or a.building != b.building:
        return False
    far, at = cKDTree(a.known[:, :2]).query(b.known[:, :2])
    near = np.argsort(far)[:25]
    of_a = se2.compose(a.map.pose[at[near]], se2.inverse(a.known[at[near]]))
    of_b = se2.compose(b.map.pose[near], se2.inverse(b.known[near]))
    true = se2.compose(of_a, se2.inverse(of_b))
    e = se2.between(se2.compose(true, b.map.pose[near]), se2.compose(transform, b.map.pose[near]))
    return bool(np.median(np.hypot(e[:, 0], e[:, 1])) < RIGHT and np.median(np.abs(e[:, 2])) < RIGHT_TURN)


def trials(logs: list[Raw], file: Path) -> None:
    pieces = [piece for raw in logs for piece in piece_maps(raw)]
    own, strange = [], []
    for a, b in combinations(pieces, 2):
        if a.building != b.building:
            strange.append((a, b))
        elif a.cut == b.cut and a.number != b.number:
            own.append((a, b))
    chosen = np.random.default_rng(0).permutation(len(strange))[:STRANGERS].tolist()
    with file.open("a", encoding="utf-8") as log:
        for a, b in [*own, *(strange[k] for k in chosen)]:
            made = merge_maps(a.map, b.map)
            kept = {
                "pair": ", ".join(f"{p.building} {p.cut}.{p.number} {len(p.known)}" for p in (a, b)),
                "kind": "one building" if a.building == b.building else "two buildings",
                "right": lies_right(made.best, a, b),
                "merged": made.merged,
                "grounds": (made.grounds or Grounds())._asdict(),
            }
            log.write(json.dumps(kept) + "\n")
            log.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--cut", type=int, action="append", default=[])
    parser.add_argument("--pairs", type=Path)
    asked = parser.parse_args()
    paths = sorted({*asked.folder.glob("*-corrected.log.gz"), *asked.folder.glob("*.gfs.log.gz")})
    logs = [raw_log(p) for p in paths if not asked.only or any(word in p.name for word in asked.only)]
    if asked.pairs is not None:
        trials(logs, asked.pairs)
        return
    print("| log | scans | way [m] | one pass [m] | several passes [m] | robots tied | verdict | CPU [s] |")
    print("|---|---|---|---|---|---|---|---|")
    for raw in logs:
        for cut in (1, *asked.cut):
            print(row(raw, cut), flush=True)


if __name__ == "__main__":
    main()
