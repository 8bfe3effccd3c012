"""Simulated teams with wrong sightings and unknown calibration, and mixed teams, beside the same teams at their best.

    python benchmarks/mixed_teams.py [--robots 2,5] [--minutes 5] [--seeds 1] [--first 0] [--outliers 0.3] [--mixed]

Camera teams: each is mapped with a share of sightings mislabelled or wrong by metres and calibrations drawn from a wide
range that nobody tells, and once more without wrong sightings and with the true calibration held. Printed: mean ATE of
both [m] and their ratio, landmark RMSE [m], and the share of poses and landmarks inside their own 3 sigma. Where every
wheel and every camera may read long or short, no data tell the size of the map better than what is assumed of cameras
beforehand: `size` is by how much it came out too large, `size_sd` what the priors of cameras and wheels leave open,
`same_size` the ratio with both maps brought to their true size. `told` is the ratio with wrong sightings and the true
calibration held. With
`--mixed`: two lasers, two cameras and one robot with bearings alone beside the same team in which everybody carries
everything: landmark RMSE, distance of occupied cells from the true walls, both ratios, NEES per degree of freedom
of landmarks and of the robots' places. `bound` is the least landmark RMSE that any estimator can expect of either
recording (`mixed_bound.py`), and `bound_ratio` by how much worse the mixed team must be for what it carries.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from mixed_bound import landmark_bound

import mapweave
from mapweave.api.evaluate import TeamTruth, read_team_truth
from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.evaluation.consistency import mean_or_none
from mapweave.evaluation.team import TeamScore, score_team
from mapweave.io.table import read_table
from mapweave.sim.mixed_team import MixedWorld, simulate_mixed
from mapweave.team.config import CalibrationPrior
from mapweave.team.team_map import TeamMap

INSIDE = 11.83  # chi-square, 2 degrees of freedom, of 3 sigma (0.27 %)
SURE = 0.65  # occupancy from which a cell is wall
PRIOR = CalibrationPrior()
Row = dict[str, float | int | None]


def scored(maps: tuple[TeamMap, ...], truth: TeamTruth) -> TeamScore:
    return score_team(maps, {}, truth.survey, truth.robots)


def nees(team: TeamMap, score: TeamScore, truth: TeamTruth) -> list[np.ndarray]:
    """NEES of the places of each robot's poses, thinned to one a second, 2 degrees of freedom."""
    T, out = score.alignment, []
    if T is None:
        return [np.full(1, np.nan)]
    R = se2.rotation(float(T[2]))
    for robot, track in team.tracks.items():
        true = truth.robots[robot].track
        t = np.arange(track.t[0], track.t[-1], 1.0)
        at = np.unique(np.searchsorted(track.t, t))
        at = at[(track.t[at] >= true.t[0]) & (track.t[at] <= true.t[-1])]
        e = (se2.compose(T, track.pose[at]) - se2.interpolate(track.t[at], true.t, true.pose))[:, :2]
        P = R @ track.cov[at][:, :2, :2] @ R.T
        out.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e))
    return out


def inside(team: TeamMap, score: TeamScore, truth: TeamTruth) -> tuple[float, float]:
    """Shares of poses, thinned to one a second, and of landmarks that lie inside their own 3 sigma."""
    T = score.alignment
    if T is None:
        return float("nan"), float("nan")
    R = se2.rotation(float(T[2]))
    poses = nees(team, score, truth)
    known = dict(zip(truth.survey.ids, truth.survey.xy, strict=True))
    marks = []
    for k, name in enumerate(team.landmarks.ids):
        if name in known:
            e = se2.act(T, team.landmarks.mean[k]) - known[name]
            P = R @ team.landmarks.cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] @ R.T
            marks.append(float(e @ np.linalg.solve(P, e)))
    return float((np.concatenate(poses) < INSIDE).mean()), float((np.array(marks) < INSIDE).mean())


def sized(team: TeamMap, truth: TeamTruth) -> tuple[TeamMap, float]:
    """The map brought to the size of the truth, and by what share it was too large."""
    known = dict(zip(truth.survey.ids, truth.survey.xy, strict=True))
    here = [k for k, name in enumerate(team.landmarks.ids) if name in known]
    p, q = team.landmarks.mean[here], np.array([known[team.landmarks.ids[k]] for k in here])
    T = se2.align(p, q)
    a, b = se2.act(T, p) - q.mean(axis=0), q - q.mean(axis=0)
    by = float((a * b).sum() / np.square(a).sum())
    m, lengths = team.landmarks, np.array([by, by, 1.0])
    tracks = {robot: replace(track, pose=track.pose * lengths) for robot, track in team.tracks.items()}
    return replace(team, landmarks=replace(m, mean=by * m.mean), tracks=tracks), 1.0 / by - 1.0


def ate(score: TeamScore) -> float:
    return mean_or_none([r.ate for r in score.robots.values()])


def cameras(robots: int, minutes: float, outliers: float, seed: int) -> Row:
    """One camera team at its worst and at its best."""
    world = {"lasers": 0, "cameras": robots, "bearings": 0, "minutes": minutes, "calibration": "random", "seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        bad, good = Path(folder) / "bad", Path(folder) / "good"
        mapweave.simulate_team(bad, outliers=outliers, **world)
        mapweave.simulate_team(good, **world)
        truth = read_team_truth([good], [f"robot{k + 1}" for k in range(robots)])
        rough = mapweave.map(bad)
        known = good / "truth" / "calibration.json"
        best, told = mapweave.map(good, calibration=known), mapweave.map(bad, calibration=known)
    a, b = scored(rough.maps, truth), scored(best.maps, truth)
    poses, marks = inside(rough.maps[0], a, truth)
    (same, size), (same_best, _) = (sized(m.maps[0], truth) for m in (rough, best))
    return {
        "robots": robots,
        "seed": seed,
        "tied": len(rough.maps[0].robots),
        "ate": ate(a),
        "ate_best": ate(b),
        "ratio": ate(a) / ate(b),
        "same_size": ate(scored((same,), truth)) / ate(scored((same_best,), truth)),
        "told": ate(scored(told.maps, truth)) / ate(b),
        "size": size,
        "size_sd": float((robots * (PRIOR.range_scale_sd**-2 + PRIOR.speed_scale_sd**-2)) ** -0.5),
        "landmarks": a.landmarks.rmse,
        "landmarks_best": b.landmarks.rmse,
        "poses_inside": poses,
        "landmarks_inside": marks,
    }


def walls_off(result: object, score: TeamScore, home: Path) -> float:
    """RMS distance [m] of the occupied cells' centres from the true walls."""
    grid = result.grids[0]
    rows, cols = np.nonzero((grid.hits > 0) & (grid.occupancy() > SURE))
    cells = grid.origin + grid.resolution * (np.stack([cols, rows], axis=-1) + 0.5)
    table = read_table(home / "truth" / "walls.csv")
    walls = Walls.of(np.column_stack([table.numbers(name) for name in ("x0", "y0", "x1", "y1")]))
    return float(np.sqrt(np.square(walls.clearance(se2.act(score.alignment, cells))).mean()))


def mixed(minutes: float, seed: int) -> Row:
    """One mixed team, and the same in which everybody carries everything."""
    told: Row = {"seed": seed}
    for name, everything in (("mixed", False), ("all", True)):
        with tempfile.TemporaryDirectory() as folder:
            home = Path(folder) / "team"
            mapweave.simulate_team(home, minutes=minutes, everything=everything, seed=seed)
            truth = read_team_truth([home], [f"robot{k}" for k in range(1, 6)])
            result = mapweave.map(home)
            score = scored(result.maps, truth)
            told[f"{name}_tied"] = len(result.maps[0].robots)
            told[f"{name}_nees"] = score.landmarks.nees_per_dof
            told[f"{name}_pose_nees"] = mean_or_none([float(q.mean()) / 2 for q in nees(result.maps[0], score, truth)])
            told[f"{name}_landmarks"] = score.landmarks.rmse
            world = MixedWorld(minutes=minutes, everything=everything)
            told[f"{name}_bound"] = landmark_bound(simulate_mixed(world, seed))
            told[f"{name}_walls"] = walls_off(result, score, home)
            told[f"{name}_ate"] = ate(score)
    told["landmark_ratio"] = told["mixed_landmarks"] / told["all_landmarks"]
    told["bound_ratio"] = told["mixed_bound"] / told["all_bound"]
    told["wall_ratio"] = told["mixed_walls"] / told["all_walls"]
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", default="2,5")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--outliers", type=float, default=0.3)
    parser.add_argument("--mixed", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    for seed in range(args.first, args.first + args.seeds):
        if args.mixed:
            rows.append(mixed(args.minutes, seed))
            print_row(rows[-1])
        else:
            for robots in map(int, args.robots.split(",")):
                rows.append(cameras(robots, args.minutes, args.outliers, seed))
                print_row(rows[-1])
    print_table(rows)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def print_table(rows: list[Row]) -> None:
    """All rows once more, as Markdown."""
    print(f"| {' | '.join(name.replace('_', ' ') for name in rows[0])} |\n|{'---|' * len(rows[0])}")
    for row in rows:
        print(f"| {' | '.join(f'{v:.3f}' if isinstance(v, float) else str(v) for v in row.values())} |")


def print_row(row: Row) -> None:
    print("  ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


if __name__ == "__main__":
    main()
