"""Whole teams smoothed at once on real logs: landmarks, trajectories and consistency, before and after.

    MAPWEAVE_DATA=... python benchmarks/team_smoothing.py [--sets 1,3,4,6] [--no-odometry] [--page FILE] [--json FILE]

Landmark RMSE and mean ATE [m] under one rigid alignment, NEES per degree of freedom of landmarks, and of poses (places
alone) where truth is dense; labels that the survey shows to be exchanged are put back. `--no-odometry` takes every
robot's wheels away. `--page` writes the table between its two marks in a page of the documentation.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import time
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mapweave.api.evaluate import TeamTruth, read_team_truth
from mapweave.api.team import team_maps
from mapweave.core import se2
from mapweave.evaluation.consistency import mean_or_none
from mapweave.evaluation.landmarks import find_exchanges
from mapweave.evaluation.team import TeamScore, score_team
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.mapping import local_map
from mapweave.team.config import PlacingConfig, SmoothingConfig
from mapweave.team.smooth import smooth
from mapweave.team.team_map import TeamMap, with_further_rooms

NEAR = 0.3  # [s] from a pose to a true one, at most, for its NEES
BEGIN, END = "<!-- team smoothing: begin -->", "<!-- team smoothing: end -->"
Row = dict[str, object]


def scored(team: TeamMap, truth: TeamTruth) -> TeamScore:
    """The score of `team`, with labels that look exchanged put back."""
    survey = find_exchanges(team.landmarks, truth.survey)[1]
    return score_team([team], {}, survey, truth.robots)


def pose_nees(team: TeamMap, score: TeamScore, truth: TeamTruth) -> float | None:
    """Mean NEES per degree of freedom of the places of all robots, at truth stamps."""
    T, out = score.alignment, []
    for robot, track in team.tracks.items():
        known = truth.robots.get(robot)
        if T is None or known is None or track.cov is None:
            continue
        true = known.track
        nearest = np.abs(true.t[np.clip(np.searchsorted(true.t, track.t), 0, len(true.t) - 1)] - track.t)
        use = (track.t >= true.t[0]) & (track.t <= true.t[-1]) & (nearest < NEAR)
        if use.any():
            e = (se2.compose(T, track.pose[use]) - se2.interpolate(track.t[use], true.t, true.pose))[:, :2]
            R = se2.rotation(float(T[2]))
            P = R @ track.cov[use][:, :2, :2] @ R.T
            known_well = np.linalg.det(P) > 0  # the filters' first pose is the frame itself
            e, P = e[known_well], P[known_well]
            out.append(float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e).mean() / 2))
    return float(np.mean(out)) if out else None


def figures(team: TeamMap, truth: TeamTruth) -> Row:
    score = scored(team, truth)
    return {
        "landmarks": len(score.landmarks.ids),
        "landmark_rmse": score.landmarks.rmse,
        "ate": mean_or_none([r.ate for r in score.robots.values()]),
        "nees": score.landmarks.nees_per_dof,
        "pose_nees": pose_nees(team, score, truth),
    }


def run(path: Path, *, odometry: bool) -> dict[str, object]:
    """One set, filtered and fused, then smoothed."""
    logs = list(read_landmark_logs(path, None))
    if not odometry:
        logs = [replace(log, odometry=None, log_hash="") for log in logs]
    began = time.process_time()
    local = [local_map(log) for log in logs]
    fusion = fuse(local, FuseConfig())
    team = team_maps(local, fusion)[0]
    team = with_further_rooms(team, local, logs, PlacingConfig(), local_map, fuse, team_maps)[0]
    fused = time.process_time()
    result = smooth(team, logs, fusion.labels, SmoothingConfig())
    done = time.process_time()
    truth = read_team_truth([path], [log.robot for log in logs])
    return {
        "set": path.stem.removeprefix("MRCLAM_Dataset"),
        "filters": {**figures(team, truth), "cpu": fused - began},
        "smoothed": {**figures(result.map, truth), "cpu": done - fused, "iterations": result.iterations},
        "robots": len(team.robots),
        "refused": result.refused,
    }


def cell(value: object, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def table(rows: list[dict[str, object]]) -> str:
    names = ("set", "", "landmarks", "landmark RMSE", "mean ATE", "NEES / dof", "of poses", "CPU [s]")
    out = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for row in rows:
        for how in ("filters", "smoothed"):
            f = row[how]
            numbers = [
                cell(f["landmark_rmse"], 4),
                cell(f["ate"], 3),
                cell(f["nees"], 2),
                cell(f["pose_nees"], 2),
                cell(f["cpu"], 1),
            ]
            out.append(f"| {row['set']} | {how} | {f['landmarks']} | {' | '.join(numbers)} |")
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("MAPWEAVE_DATA"))
    parser.add_argument("--sets", default="1,3,4,6")
    parser.add_argument("--no-odometry", action="store_true")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if args.data is None:
        parser.error("say where the real logs are: --data or MAPWEAVE_DATA")
    machine = {name: version(name) for name in ("mapweave", "numpy", "scipy")}
    machine |= {"python": platform.python_version(), "cores": str(os.cpu_count()), "processor": platform.machine()}
    print(json.dumps(machine), flush=True)
    print(table([]), flush=True)
    rows = []
    for name in args.sets.split(","):
        rows.append(run(Path(args.data) / "mrclam" / f"MRCLAM_Dataset{name}.zip", odometry=not args.no_odometry))
        print(table(rows[-1:]).split("\n", 2)[2], flush=True)
    if args.json:
        args.json.write_text(json.dumps({"machine": machine, "sets": rows}, indent=1) + "\n", encoding="utf-8")
    if args.page:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        when = f"{datetime.now(UTC):%Y-%m-%d}, at {commit.stdout.strip()}"
        told = f"{table(rows)}\n\nWritten by `python benchmarks/team_smoothing.py`, {when}."
        page = args.page.read_text(encoding="utf-8")
        marked = re.compile(re.escape(BEGIN) + ".*?" + re.escape(END), re.DOTALL)
        if not marked.search(page):
            parser.error(f"{args.page}: no marks {BEGIN} and {END}")
        args.page.write_text(marked.sub(lambda _: f"{BEGIN}\n{told}\n{END}", page), encoding="utf-8")


if __name__ == "__main__":
    main()
