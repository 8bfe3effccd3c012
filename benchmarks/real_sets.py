"""Fused landmark maps of the real teams against their surveys: every weighting, whole logs and unequal ones.

    MAPWEAVE_DATA=... python benchmarks/real_sets.py [--sets 1,3,4,6] [--table whole] [--json FILE]

First table: landmark RMSE [m] after one rigid alignment and NEES per degree of freedom, whole logs. Second: robots
are given 100, 50, 25, 12 and 6 % of the time, rotated through all roles (those without odometry left out). Third:
maps without common names, pair by pair; and labels exchanged in one robot, found again. In set 1 the survey's
11 and 17 are exchanged back.
"""

import argparse
import itertools
import json
import os
import platform
import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mapweave.core.truth import Survey
from mapweave.evaluation.landmarks import rmse_after_alignment, score_landmarks
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.identities import match_maps
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.landmark_truth import read_survey
from mapweave.landmarks.mapping import local_map

WEIGHTS = ("naive", "constant", "paper", "diagonal", "full", "full-scaled")
SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)


def load(folder, name):
    """Logs and survey of one set; set 1's survey with the labels exchanged back."""
    path = folder / "mrclam" / f"MRCLAM_Dataset{name}.zip"
    survey = read_survey(path)
    if name == "1":
        back = {"11": "17", "17": "11"}
        survey = Survey(tuple(back.get(i, i) for i in survey.ids), survey.xy)
    return read_landmark_logs(path), survey


def whole(name, maps, survey):
    """Every weighting on whole logs."""
    singles = [rmse_after_alignment(m.submap.landmarks, survey) for m in maps]
    row = {"set": name, "mean_single": float(np.mean([s for s in singles if s is not None]))}
    for weights in WEIGHTS:
        tic = time.perf_counter()
        fused = fuse(maps, FuseConfig(weights=weights))
        seconds = time.perf_counter() - tic
        score = score_landmarks(fused.components[0].map, survey)
        row[weights] = {"rmse": score.rmse, "nees_per_dof": score.nees_per_dof, "seconds": seconds}
    seen = fuse(maps, FuseConfig(robot_sightings=True))
    score = score_landmarks(seen.components[0].map, survey)
    row["with robot sightings"] = {"rmse": score.rmse, "nees_per_dof": score.nees_per_dof}
    return row


def unequal(name, logs, survey):
    """RMSE of every weighting with the shares in every rotation."""
    driven = [log for log in logs if log.odometry is not None]
    parts = {(log.robot, s): local_map(log.share(s)) for log in driven for s in SHARES}
    rows = []
    for turn in range(len(SHARES)):
        maps = [parts[log.robot, SHARES[(i + turn) % len(SHARES)]] for i, log in enumerate(driven)]
        singles = [rmse_after_alignment(m.submap.landmarks, survey) for m in maps]
        row = {"set": name, "turn": turn, "single": float(np.mean([s for s in singles if s is not None]))}
        for weights in WEIGHTS:
            fused = fuse(maps, FuseConfig(weights=weights))
            row[weights] = score_landmarks(fused.components[0].map, survey).rmse
        rows.append(row)
    return rows


def nameless(maps):
    """Of all pairs of maps whose names are ignored: how many, how many accepted and all right, seconds a pair."""
    pairs = right = wrong = 0
    tic = time.perf_counter()
    for a, b in itertools.combinations(maps, 2):
        one, two = a.submap.landmarks, b.submap.landmarks
        match = match_maps(one, two)
        names = [(one.ids[i], two.ids[j]) for i, j in match.links]
        all_right = all(i == j for i, j in names)
        pairs += 1
        right += match.accepted and all_right and len(names) == len(set(one.ids) & set(two.ids))
        wrong += match.accepted and not all_right
    return {"pairs": pairs, "all_right": right, "accepted_wrong": wrong, "seconds": (time.perf_counter() - tic) / pairs}


def exchanged(maps, rng, cases=12):
    """Labels more than a metre apart exchanged in one robot: how often that is found and put back."""
    found = 0
    for _ in range(cases):
        k = int(rng.integers(len(maps)))
        submap = maps[k].submap
        apart = np.hypot(*np.moveaxis(submap.mean[:, None] - submap.mean[None], -1, 0))
        a, b = (int(i) for i in rng.permutation(np.argwhere(apart > 1.0))[0])
        ids = list(submap.ids)
        ids[a], ids[b] = ids[b], ids[a]
        wrong = [*maps[:k], replace(maps[k], submap=replace(submap, ids=tuple(ids))), *maps[k + 1 :]]
        labels = fuse(wrong).labels
        found += labels == {maps[k].robot: {ids[a]: ids[b], ids[b]: ids[a]}}
    return {"cases": cases, "found": found}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("MAPWEAVE_DATA", "data")))
    parser.add_argument("--sets", default="1,3,4,6")
    parser.add_argument("--table", choices=("whole", "unequal", "names"), help="this one alone")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    machine = {name: version(name) for name in ("mapweave", "numpy", "scipy")}
    machine |= {"python": platform.python_version(), "cores": os.cpu_count(), "processor": platform.machine()}
    print(json.dumps(machine))
    table, turns, pairs, swaps = [], [], [], []
    rng = np.random.default_rng(0)
    for name in args.sets.split(","):
        logs, survey = load(args.data, name)
        if args.table in {None, "unequal"}:
            turns += unequal(name, logs, survey)
        maps = [] if args.table == "unequal" else [local_map(log) for log in logs]
        if args.table in {None, "whole"}:
            table.append(whole(name, maps, survey))
        if args.table in {None, "names"}:
            pairs.append(nameless(maps))
            swaps.append(exchanged(maps, rng))
    if table:
        print_whole(table)
    if turns:
        print_unequal(turns)
    if pairs:
        print_names(pairs, swaps)
    if args.json:
        out = {"machine": machine, "whole": table, "unequal": turns, "identities": pairs, "exchanged": swaps}
        args.json.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")


def print_whole(table):
    columns = [*WEIGHTS, "with robot sightings"]
    print(f"| set | mean single | {' | '.join(columns)} | NEES of full-scaled |")
    print(f"|---|---{'|---' * len(columns)}|---|")
    for row in table:
        name = "1 (11 and 17 exchanged back)" if row["set"] == "1" else row["set"]
        cells = " | ".join(f"{row[c]['rmse']:.3f}" for c in columns)
        print(f"| {name} | {row['mean_single']:.3f} | {cells} | {row['full-scaled']['nees_per_dof']:.2f} |")


def print_unequal(turns):
    print("| weights | mean of " + str(len(turns)) + " cases [m] |")
    print("|---|---|")
    for column in ("single", *WEIGHTS):
        print(f"| {column} | {np.mean([row[column] for row in turns]):.3f} |")


def print_names(pairs, swaps):
    total = {key: sum(p[key] for p in pairs) for key in ("pairs", "all_right", "accepted_wrong")}
    seconds = np.mean([p["seconds"] for p in pairs])
    print("| what | tried | right | believed wrongly | seconds each |")
    print("|---|---|---|---|---|")
    print(
        f"| two maps without names | {total['pairs']} | {total['all_right']} | {total['accepted_wrong']} | "
        f"{seconds:.1f} |"
    )
    found, cases = sum(s["found"] for s in swaps), sum(s["cases"] for s in swaps)
    print(f"| two labels exchanged in one robot | {cases} | {found} | | |")


if __name__ == "__main__":
    main()
