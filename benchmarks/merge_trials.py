"""Pairs of robots with unknown starts in simulated buildings: maps merged rightly, wrongly, or refused, and why.

    python benchmarks/merge_trials.py [--trials N] [--seed S] [--kinds office,corridor,..] [--pictures] [--page FILE]
        [--log FILE]

Kinds: `office` floors with 0 to 80 % of the way shared, any rotation; `corridor`, straight and flush; `symmetric`
floors that look the same turned by 180 degrees, half of the way shared at least; `repetitive` rows of equal rooms;
`strangers`: two different floors. On request `twins`: symmetric floors of which each robot may have seen another half,
which must be refused: two places fit.

`--pictures` has the same pairs merged by features of their pictures too (`image_merge.py`); `--page` writes the table
between its two marks in a page of the documentation. `--log` keeps every trial: the same command goes on after those
that are there, as long as the rules of merging are the same.
"""

import argparse
import json
import re
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from laser_pairs import MapPair, PairConfig, drive_pair

from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.mapping.merge import Merge, merge_maps
from mapweave.sim.laser_worlds import office_floor

KINDS = ("office", "office", "office", "corridor", "symmetric", "repetitive", "strangers")
BEGIN, END = "<!-- merge trials: begin -->", "<!-- merge trials: end -->"
PICTURES = "ORB and RANSAC"
NEAR, NEAR_TURN = 0.5, 0.09  # [m, rad] a merge that errs by less is right


def office(rng: np.random.Generator, share: float) -> MapPair:
    floor = office_floor(float(rng.uniform(500, 1100)), int(rng.integers(1_000_000)))
    return drive_pair(Walls.of(floor.world.segments), floor.lower + 4.0, floor.upper - 4.0, share, rng)


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


def corridor(rng: np.random.Generator, share: float) -> MapPair:
    """Straight, flush, 80 m long: no robot sees its ends."""
    walls = Walls.of(np.array(box(-25.0, 0.0, 105.0, 2.5)))
    cfg = PairConfig(keyframes=140)
    return drive_pair(walls, np.array([0.0, 0.0]), np.array([80.0, 2.5]), share, rng, cfg)


def symmetric(rng: np.random.Generator, share: float) -> MapPair:
    return twins(rng, 0.5 + 0.5 * share)


def twins(rng: np.random.Generator, share: float) -> MapPair:
    """Rooms of chance widths, doors and furniture along half a corridor, and all of it turned by 180 degrees."""
    parts = [[-20.0, 5.6, 0.0, 5.6], [-20.0, -5.6, 0.0, -5.6], [-20.0, -5.6, -20.0, 5.6]]
    for side in (1.0, -1.0):
        x = -20.0
        while x < -2.5:
            wide = min(float(rng.uniform(3.0, 6.0)), -x)
            door = x + float(rng.uniform(0.6, wide - 1.6))
            parts += [[x, 1.1 * side, door, 1.1 * side], [door + 1.0, 1.1 * side, x + wide, 1.1 * side]]
            parts += [[x + wide, 1.1 * side, x + wide, 5.6 * side]]
            at, y = x + float(rng.uniform(0.0, wide - 0.8)), side * float(rng.uniform(3.6, 4.8))
            parts += box(at, y, at + 0.8, y + side * 0.6)
            x += wide
        parts += [[x, 1.1 * side, 0.0, 1.1 * side]]
    half = np.array(parts)
    walls = Walls.of(np.concatenate([half, -half]))
    return drive_pair(walls, np.array([-20.0, -5.6]), np.array([20.0, 5.6]), share, rng)


def repetitive(rng: np.random.Generator, share: float) -> MapPair:
    """Ten equal rooms on one side of a corridor, no furniture, ends out of sight."""
    parts = [[-30.0, 0.0, 70.0, 0.0], [-30.0, 0.0, -30.0, 2.0], [70.0, 0.0, 70.0, 2.0]]
    for k in range(-8, 18):
        x = 4.0 * k
        parts += [[x, 2.0, x + 1.5, 2.0], [x + 2.5, 2.0, x + 4.0, 2.0], [x, 2.0, x, 6.0], [x, 6.0, x + 4.0, 6.0]]
    cfg = PairConfig(keyframes=160)
    return drive_pair(Walls.of(np.array(parts)), np.array([0.0, 0.0]), np.array([40.0, 6.0]), share, rng, cfg)


def strangers(rng: np.random.Generator, share: float) -> MapPair:
    one, other = office(rng, share), office(rng, share)
    return MapPair(one.a, other.b, np.full(3, np.inf), 0.0)


MAKERS = {"office": office, "corridor": corridor, "symmetric": symmetric, "repetitive": repetitive}
MAKERS |= {"strangers": strangers, "twins": twins}


def judged(pair: MapPair, transform: np.ndarray | None) -> str:
    if transform is None:
        return "refused"
    if not np.isfinite(pair.transform).all():
        return "wrong"
    e = se2.between(pair.transform, transform)
    return "right" if np.hypot(*e[:2]) < NEAR and abs(e[2]) < NEAR_TURN else "wrong"


def trial(seed: int, kinds: tuple[str, ...] = KINDS) -> tuple[str, float, MapPair, Merge, str]:
    """Kind, share of the way, the pair, the decision and whether it was right."""
    rng = np.random.default_rng([seed, 17])
    kind = kinds[seed % len(kinds)]
    share = float(rng.uniform(0.0, 0.8))
    pair = MAKERS[kind](rng, share)
    merge = merge_maps(pair.a, pair.b)
    return kind, share, pair, merge, judged(pair, merge.transform)


def tried(seed: int, kinds: tuple[str, ...], *, pictures: bool) -> dict[str, Any]:
    """A trial, printed: kind, share, verdicts by who merged."""
    started = process_time()
    kind, share, pair, merge, verdict = trial(seed, kinds)
    took = process_time() - started
    verdicts = {"mapweave": verdict}
    if pictures:
        from image_merge import merged_by_features

        verdicts[PICTURES] = judged(pair, merged_by_features(pair.a, pair.b))
    print(
        f"{seed:4d} {kind:10s} way {share:.2f} walls {pair.overlap:.2f} {' '.join(verdicts.values()):15s} agreeing "
        f"{merge.agreeing:2d} alike {merge.alike or 0:.3f} {took:5.1f} s CPU  {merge.reason}",
        flush=True,
    )
    return {"kind": kind, "share": share, "verdicts": verdicts}


def logged(path: Path, kinds: str, *, pictures: bool) -> dict[int, dict[str, Any]]:
    """The trials in a log that were asked for in the same words."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {t["seed"]: t for t in lines if t["kinds"] == kinds and (PICTURES in t["verdicts"]) == pictures}


def table(rows: dict[str, dict[str, list[int]]], told: str) -> str:
    """Kinds against who merged them: right / wrong / refused. told: the command."""
    names = list(next(iter(rows.values())))
    lines = [f"| pairs | n | {' | '.join(names)} |", "|---|---|" + "---|" * len(names)]
    for kind, row in sorted(rows.items()):
        cells = " | ".join(" / ".join(map(str, row[name])) for name in names)
        lines.append(f"| {kind} | {sum(row[names[0]])} | {cells} |")
    return "\n".join([*lines, "", f"Right / wrong / refused, by `{told}`."])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=70)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--log", type=Path)
    asked = parser.parse_args()
    kinds = tuple(asked.kinds.split(","))
    rows: dict[str, dict[str, list[int]]] = {}
    done = (
        {} if asked.log is None or not asked.log.is_file() else logged(asked.log, asked.kinds, pictures=asked.pictures)
    )
    for seed in range(asked.seed, asked.seed + asked.trials):
        made = done.get(seed) or tried(seed, kinds, pictures=asked.pictures)
        if asked.log is not None and seed not in done:
            with asked.log.open("a", encoding="utf-8") as log:
                log.write(json.dumps({"seed": seed, "kinds": asked.kinds, **made}) + "\n")
        kind, share = made["kind"], made["share"]
        name = kind if kind != "office" else f"office, {'over' if share >= 0.25 else 'under'} 25 % of the way shared"
        for who, said in made["verdicts"].items():
            counts = rows.setdefault(name, {}).setdefault(who, [0, 0, 0])
            counts[("right", "wrong", "refused").index(said)] += 1
    command = f"benchmarks/merge_trials.py --trials {asked.trials} --seed {asked.seed}"
    command += "" if kinds == KINDS else f" --kinds {asked.kinds}"
    told = table(rows, command + (" --pictures" if asked.pictures else ""))
    print(f"\n{told}")
    if asked.page is not None:
        page = asked.page.read_text(encoding="utf-8")
        marked = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
        asked.page.write_text(marked.sub(lambda _: f"{BEGIN}\n{told}\n{END}", page), encoding="utf-8")


if __name__ == "__main__":
    main()
