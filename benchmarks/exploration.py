"""What exploration costs and what it brings: decision times, runs, submaps against one big filter, planners, teams.

python benchmarks/exploration.py [--quick] [--jobs 2] [--out exploration.json]
python benchmarks/exploration.py --table submaps|walls|starts|radio|kidnapped      # a table of the documentation, alone
"""

import argparse
import json
import re
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mapweave.core.se2 import wrap_angle
from mapweave.core.workers import one_blas_thread, worker_pool
from mapweave.exploration.landmarks import coverage, objective
from mapweave.exploration.landmarks.config import ExploreConfig, MissionConfig, bounds, find_scenario, make_field
from mapweave.exploration.landmarks.experiment import (
    CALIBRATED,
    LandmarkMission,
    LandmarkRunScore,
    explore_many,
    explore_once,
    with_noise,
)
from mapweave.exploration.landmarks.team import Team
from mapweave.fusion.handover import hand_over
from mapweave.kernels.landmarks import ekf
from mapweave.kernels.landmarks.submap import sight_jacobian
from mapweave.landmarks.config import EkfSlamConfig, noise
from mapweave.landmarks.landmark_map import GlobalMap, Submap
from mapweave.landmarks.submap_slam import (
    Observations,
    SubmapConfig,
    empty,
    move,
    predict,
    predicted_observation,
    update,
)

STEPS, SIGHTINGS = 30, 3
SIZES = (100, 500, 2000)  # landmarks
PAGE = Path(__file__).resolve().parents[1] / "docs" / "methods" / "active-exploration.md"
HALL = re.compile(r"### Walls\n\n```toml\n(.*?)```", re.DOTALL)  # the scenario among walls, as the page prints it
AMONG_WALLS = (  # planner, robots, runs
    *((planner, 2, 20) for planner in ("paper", "area", "coverage", "loop")),
    ("coverage", 1, 10), ("coverage", 4, 10), ("loop", 4, 10),
)  # fmt: skip
UNKNOWN_STARTS = (  # planner, robots, association, whether they start anywhere
    ("paper", 2, "jcbb", False), ("paper", 2, "known", False), ("paper", 4, "jcbb", False),
    ("coverage", 2, "jcbb", False), ("paper", 2, "jcbb", True), ("paper", 4, "jcbb", True),
)  # fmt: skip
UNSEEN = range(500, 520)  # seeds on which nothing was chosen
KIDNAPPED = (  # planner, robots, association, which is carried away, at which step
    ("paper", 2, "jcbb", 1, 100), ("paper", 2, "known", 1, 100), ("paper", 2, "jcbb", 0, 100),
    ("paper", 1, "jcbb", 0, 150), ("paper", 4, "jcbb", 2, 60), ("coverage", 2, "jcbb", 1, 100),
)  # fmt: skip
RADIO = (  # planner, robots, range [m]
    *(("paper", 2, m) for m in (np.inf, 40.0, 20.0)), *(("paper", 4, m) for m in (np.inf, 40.0, 20.0)),
    *(("coverage", 2, m) for m in (np.inf, 40.0, 20.0)),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="4 runs a row, no map of 2,000 landmarks")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--table", choices=tuple(TABLES), help="this table alone, in Markdown")
    args = parser.parse_args()
    if args.table:
        TABLES[args.table]()
        return
    runs = 4 if args.quick else 30
    out = {"decisions": decisions(), "cost": [cost(n) for n in (SIZES[:2] if args.quick else SIZES)]}
    with worker_pool(args.jobs, max(runs, 3)) as pool:
        out["planners"] = planners(pool, runs, args.jobs)
        out["scaling"] = scaling(pool, 4 if args.quick else 10)
        out["hardship"] = hardship(pool, runs)
    if args.out:
        args.out.write_text(json.dumps(out, indent=1), encoding="utf-8")


def print_starts() -> None:
    head = ("planner", "robots", "identities", "starts", "runs with one map", "wrongly joined", "one map at step")
    head = (*head, *(f"{what}, {who}" for what in ("steps", "map error", "NEES/dof") for who in ("told", "not told")))
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for planner, robots, association, anywhere in UNKNOWN_STARTS:
        told, apart = (
            [with_starts(planner, robots, association, seed, anywhere=anywhere, apart=a) for seed in UNSEEN]
            for a in (False, True)
        )
        met = [r.met for r in apart if r.maps == 1]
        cells = [
            f"`{planner}`",
            robots,
            "known" if association == "known" else "unknown",
            "anywhere" if anywhere else "the paper's",
            f"{len(met)} of {len(apart)}",
            sum(r.wrong_meetings for r in apart),
            f"{min(met)} / {np.median(met):.0f} / {max(met)}",
            *(f"{np.mean([r.steps for r in runs]):.0f}" for runs in (told, apart)),
            *(f"{np.mean([r.map_error for r in runs]):.3f} m" for runs in (told, apart)),
            *(f"{np.mean([r.nees_per_dof for r in runs]):.2f}" for runs in (told, apart)),
        ]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_radio() -> None:
    head = ("planner", "robots", "radio", "rendezvous", "finished", "in touch", "steps", "map error", "NEES/dof")
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for planner, robots, reach in RADIO:
        for every in (100, 0) if np.isfinite(reach) else (100,):
            cfg = with_noise(ExploreConfig(mission=MissionConfig(rendezvous=every)), CALIBRATED)
            task = LandmarkMission(find_scenario("yuan"), robots, planner, "landmarks", cfg=cfg, radio=reach)
            runs = explore_many(task, len(UNSEEN), UNSEEN[0])
            cells = (
                f"`{planner}`",
                robots,
                f"{reach:g} m" if np.isfinite(reach) else "any",
                f"{every} steps" if every and np.isfinite(reach) else "when all is seen" if not every else "",
                f"{sum(r.finished for r in runs)} of {len(runs)}",
                f"{100 * np.mean([r.in_touch for r in runs]):.0f} %",
                f"{np.mean([r.steps for r in runs]):.0f}",
                f"{np.mean([r.map_error for r in runs]):.3f} m",
                f"{np.mean([r.nees_per_dof for r in runs]):.2f}",
            )
            print(f"| {' | '.join(map(str, cells))} |", flush=True)


def print_kidnapped() -> None:
    head = ("planner", "robots", "identities", "carried", "finished", "found again", "after steps", "wrongly", "steps")
    print(f"| {' | '.join((*head, 'map error', 'NEES/dof'))} |\n{'|---' * (len(head) + 2)}|")
    for planner, robots, association, who, step in KIDNAPPED:
        cfg = with_noise(ExploreConfig(submap=SubmapConfig(association=association)), CALIBRATED)
        task = LandmarkMission(find_scenario("yuan"), robots, planner, "landmarks", cfg=cfg, kidnaps={who: step})
        runs, records = zip(*(explore_once(task, seed) for seed in UNSEEN), strict=True)
        after = [told.back - told.step for r in records for told in r.carried if told.back is not None]
        cells = (
            f"`{planner}`",
            robots,
            "known" if association == "known" else "unknown",
            f"robot {who + 1} at step {step}",
            f"{sum(r.finished for r in runs)} of {len(runs)}",
            len(after),
            f"{min(after)} / {np.median(after):.0f} / {max(after)}",
            sum(r.wrong_meetings for r in runs),
            f"{np.mean([r.steps for r in runs]):.0f}",
            f"{np.mean([r.map_error for r in runs]):.3f} m",
            f"{np.mean([r.nees_per_dof for r in runs]):.2f}",
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def with_starts(
    planner: str, robots: int, association: str, seed: int, *, anywhere: bool, apart: bool
) -> LandmarkRunScore:
    """One run in the paper's field until all landmarks are seen, with starts that robots are told or not (`apart`)."""
    scenario = find_scenario("yuan")
    if anywhere:
        lower, upper = bounds(scenario)
        rng = np.random.default_rng([seed, 2])
        places = rng.uniform([*lower, -np.pi], [*upper, np.pi], size=(robots, 3))
        scenario = replace(scenario, starts=tuple(map(tuple, places.tolist())))
    cfg = with_noise(ExploreConfig(submap=SubmapConfig(association=association)), CALIBRATED)
    task = LandmarkMission(scenario, robots, planner, "landmarks", cfg=cfg, apart=apart)
    return explore_once(task, seed)[0]


def print_submaps() -> None:
    rows = [cost(n) for n in SIZES]
    filters = [name for name in rows[0] if f"{name}, ratio" in rows[0]]
    print(f"| landmarks | submap and hand-over | {' | '.join(filters)} |")
    print(f"|---|---{'|---' * len(filters)}|")
    for row in rows:
        cells = [f"{1e3 * row[name]:,.1f} ms ({row[f'{name}, ratio']:.1f} times)" for name in filters]
        print(f"| {row['landmarks']:,} | {1e3 * row['submap_s']:.1f} ms | {' | '.join(cells)} |")


def print_walls() -> None:
    found = HALL.search(PAGE.read_text(encoding="utf-8"))
    if found is None:
        raise SystemExit(f"{PAGE}: no scenario under 'Walls'")
    print("| planner | robots, runs | finished | steps min / mean / max | map error | C/N | NEES/dof | contacts |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        hall = Path(folder) / "hall.toml"
        hall.write_text(found[1], encoding="utf-8")
        for planner, robots, runs in AMONG_WALLS:
            scores = explore_many(mission(planner, robots, str(hall), until="field"), runs, 0)
            row = row_of(f"{planner}, {robots} robots among walls", scores)
            cells = (
                f"`{planner}`",
                f"{robots}, {runs}",
                row["finished"],
                f"{row['steps_min']} / {row['steps_mean']:.0f} / {row['steps_max']}",
                f"{row['map_error']:.3f} m",
                f"{row['c_per_n']:.3f} m²",
                f"{row['nees_per_dof']:.2f}",
                sum(r.collisions for r in scores),
            )
            print(f"| {' | '.join(map(str, cells))} |", flush=True)


def decisions() -> dict:
    """Milliseconds of processor time a decision: median and worst of many."""
    rng = np.random.default_rng(0)
    world = make_field(find_scenario("yuan"), 1, 0)
    cfg = ExploreConfig()
    team = Team(world, cfg, objective.choose, rng)
    A = 0.02 * rng.normal(size=(63, 63))
    marks = rng.uniform(-14, 14, (30, 2))
    team.submaps[0] = Submap("robot1", np.zeros(3), tuple(map(str, range(30))), marks, A @ A.T + 1e-4 * np.eye(63), "l")
    one = timed(lambda: objective.choose(team.belief(), team.poses(), cfg), 200)
    eight = Team(make_field(find_scenario("yuan"), 8, 0), cfg, coverage.choose, rng)
    view = eight.belief()

    def fresh() -> None:
        eight.memory.clear()
        coverage.choose(view, eight.poses(), cfg)

    eight_ms = timed(fresh, 50)
    table = {
        "paper, 1 robot, 36 controls, 30 landmarks, 8,000 cells": one,
        "coverage, 8 robots, all planned anew": eight_ms,
    }
    for name, (middle, worst) in table.items():
        print(f"{name:58s} {middle:7.2f} ms median, {worst:7.2f} ms worst")
    return {k: {"median_ms": v[0], "worst_ms": v[1]} for k, v in table.items()}


def timed(job, times: int) -> tuple[float, float]:
    job()
    spent = []
    for _ in range(times):
        begun = time.process_time()
        job()
        spent.append(1e3 * (time.process_time() - begun))
    return float(np.median(spent)), float(np.max(spent))


@one_blas_thread()
def cost(n: int) -> dict:
    """30 steps, 3 sightings each, in processor time [s]: a submap and its hand-over; one filter over all landmarks.

    The least of several times on either side: what others do on the machine costs both. On one thread: several that
    wait for each other spend processor time on waiting.
    """
    rng = np.random.default_rng(n)
    cfg = SubmapConfig(association="known")
    side = 6.0 * np.sqrt(n)
    marks = rng.uniform(-side / 2, side / 2, (n, 2))
    near = np.argsort(np.hypot(*marks.T))[:12]  # what the robot meets on its way
    U = 0.05 * rng.normal(size=(3 + 2 * n, 40))
    P = U @ U.T + 1e-3 * np.eye(3 + 2 * n)
    ids = tuple(map(str, range(n)))
    G = GlobalMap(("robot1",), np.zeros((1, 3)), ids, marks, P)
    u, pose, script = np.array([0.5, 0.1]), np.zeros(3), []
    for _ in range(STEPS):
        pose, rows = move(pose, u, cfg.period), rng.choice(near, SIGHTINGS, replace=False)
        z = predicted_observation(pose, marks[rows]) + rng.normal(size=(SIGHTINGS, 2)) * (cfg.range_sd, cfg.bearing_sd)
        script.append((rows, z, Observations(z, tuple(ids[k] for k in rows))))

    def submap() -> float:
        begun = time.process_time()
        m = empty("robot1", "local_1")
        for _, _, seen in script:
            m, _ = update(predict(m, u, cfg), seen, cfg)
        hand_over(G, m, known=True)
        return time.process_time() - begun

    least = min(submap() for _ in range(20))
    row = {"landmarks": n, "submap_s": least}
    print(f"{n:5d} landmarks: {'submap and hand-over':34s} {1e3 * least:9.1f} ms")
    for name, full in {
        "full EKF, one sighting at a time": lambda: textbook(P, marks, script, u, cfg, 1),
        "full EKF, a step's sightings together": lambda: textbook(P, marks, script, u, cfg, SIGHTINGS),
        "full EKF, compiled, one pass a step": lambda: compiled(P, marks, script, u, cfg),
    }.items():
        spent = min(full() for _ in range(4))
        row |= {name: spent, f"{name}, ratio": spent / least}
        print(f"{'':17s}{name:35s} {1e3 * spent:8.1f} ms (x {spent / least:.1f})")
    return row | limit(P, len({int(k) for rows, _, _ in script for k in rows}), row)


def limit(P: np.ndarray, met: int, row: dict) -> dict:
    """What a hand-over cannot go below while the old map stays as it is: its covariance written anew, once.

    met: landmarks of the submap, each in the map. Counted on covariances of n x n numbers of 8 bytes. The filter
    subtracts 2 rows a sighting over the whole square and reads and writes all of it, each step. A hand-over copies the
    square, subtracts 2 rows a landmark over one triangle, and mirrors that.
    """
    n = len(P)
    full_ops, once_ops = STEPS * 2 * SIGHTINGS * n * n, met * n * n
    full_bytes, once_bytes = STEPS * 16 * n * n, (16 + 8 + 8) * n * n
    copying = min(_copied(P) for _ in range(8))
    full = row["full EKF, compiled, one pass a step"]
    told = {
        "operations_ratio": full_ops / once_ops,
        "bytes_ratio": full_bytes / once_bytes,
        "copy_s": copying,
        "limit_ratio": full / copying,
    }
    print(
        f"{'':17s}counted: {full_ops / 1e6:.0f} against {once_ops / 1e6:.0f} million multiplications and additions (x "
        f"{told['operations_ratio']:.1f}), {full_bytes / 1e6:.0f} against {once_bytes / 1e6:.0f} MB read and written "
        f"(x {told['bytes_ratio']:.0f})"
    )
    print(
        f"{'':17s}a bare copy of the map's covariance {1e3 * copying:9.1f} ms: no hand-over that leaves the old map as "
        f"it is gets beyond x {told['limit_ratio']:.1f} of the compiled filter"
    )
    return told


def _copied(P: np.ndarray) -> float:
    """Processor time [s] of a copy into fresh memory."""
    begun = time.process_time()
    P.copy()
    return time.process_time() - begun


def textbook(P: np.ndarray, marks: np.ndarray, script: list, u: np.ndarray, cfg: SubmapConfig, at_once: int) -> float:
    """Processor time [s] of one filter over robot and all landmarks, `at_once` sightings an update, P changed in place.

    Only the columns a sighting depends on are multiplied: `P H^T` costs little, `P - W W^T` is what takes the time.
    """
    x, P = np.concatenate([np.zeros(3), marks.ravel()]), P.copy()
    begun = time.process_time()
    for rows, z, _ in script:
        J = np.eye(3)
        J[:2, 2] = u[0] * cfg.period * np.array([-np.sin(x[2]), np.cos(x[2])])
        x[:3] = move(x[:3], u, cfg.period)
        P[:3] = J @ P[:3]
        P[:, :3] = P[:, :3] @ J.T
        P[:3, :3] += cfg.Q
        for k in range(0, len(rows), at_once):
            some = rows[k : k + at_once]
            used = np.concatenate([np.arange(3), *(3 + 2 * j + np.arange(2) for j in some)])
            H, one = np.zeros((2 * len(some), len(used))), np.empty((2, 5))
            for i, j in enumerate(some):
                sight_jacobian(x[:3], x[3 + 2 * j : 5 + 2 * j], one)
                H[2 * i : 2 * i + 2, :3], H[2 * i : 2 * i + 2, 3 + 2 * i : 5 + 2 * i] = one[:, :3], one[:, 3:]
            e = z[k : k + at_once] - predicted_observation(x[:3], x[3:].reshape(-1, 2)[some])
            e[:, 1] = wrap_angle(e[:, 1])
            PH = P[:, used] @ H.T
            L = np.linalg.cholesky(H @ PH[used] + np.kron(np.eye(len(some)), cfg.R))
            W = np.linalg.solve(L, PH.T).T
            x += W @ np.linalg.solve(L, e.ravel())
            P -= W @ W.T
    return time.process_time() - begun


def compiled(P: np.ndarray, marks: np.ndarray, script: list, u: np.ndarray, cfg: SubmapConfig) -> float:
    """The same by the kernels `map` uses for its landmark logs: a step's sightings pass over P once, in place."""
    n, n_marks = ekf.HEAD, len(marks)
    x = np.concatenate([np.zeros(3), [1.0, 1.0, 0.0, 0.0, 1.0], marks.ravel()])
    own = np.concatenate([np.arange(3), n + np.arange(2 * n_marks)])
    F = np.zeros((len(x), len(x)))
    F[np.ix_(own, own)] = P
    config = EkfSlamConfig(
        range_floor=cfg.range_sd, range_share=0.0, bearing=cfg.bearing_sd, range_inflation=1.0, bearing_inflation=1.0,
        gate=1e9, far=1e9,
    )  # fmt: skip
    known, Phi = noise(config), np.zeros((3, n))
    waiting = np.zeros((n_marks, ekf.CANDIDATES, 2))
    places = ekf.LandmarkTable(np.ones(n_marks, bool), waiting, np.zeros(n_marks, np.int64), np.zeros(1, np.int64))
    begun = time.process_time()
    for rows, z, _ in script:
        Phi[:, :3] = np.eye(3)
        Phi[:2, 2] = u[0] * cfg.period * np.array([-np.sin(x[2]), np.cos(x[2])])
        x[:3] = move(x[:3], u, cfg.period)
        ekf.apply_drive(F, len(x), Phi, cfg.Q.copy())
        ranges, bearings = z.T.copy()
        fit = ekf.UpdateOutcomes(np.empty(len(rows)), np.empty(len(rows)))
        ekf.frame(x, F, ekf.CameraFrame(rows, ranges, bearings), known, places, fit)
    return time.process_time() - begun


TABLES = {
    "submaps": print_submaps,
    "walls": print_walls,
    "starts": print_starts,
    "radio": print_radio,
    "kidnapped": print_kidnapped,
}


def mission(
    planner="paper", robots=2, scenario="yuan", until="landmarks", how="known", kills=None, drop=0.0
) -> LandmarkMission:
    cfg = with_noise(ExploreConfig(), CALIBRATED)
    cfg = replace(cfg, submap=replace(cfg.submap, association=how))
    return LandmarkMission(find_scenario(scenario), robots, planner, until, kills, drop, cfg)


def row_of(name: str, scores) -> dict:
    def mean(what: str) -> float:
        return float(np.mean([v for r in scores if (v := getattr(r, what)) is not None]))

    steps = [r.steps for r in scores]
    row = {"name": name, "runs": len(scores), "finished": sum(r.finished for r in scores)}
    row |= {"steps_min": min(steps), "steps_mean": mean("steps"), "steps_max": max(steps)}
    row |= {
        k: mean(k) for k in ("map_error", "c_per_n", "nees_per_dof", "misassociations", "missed", "ms_per_decision")
    }
    print(
        f"{name:34s} {row['finished']:2d}/{row['runs']:2d}  steps {row['steps_min']:4d} / {row['steps_mean']:6.1f} / "
        f"{row['steps_max']:4d}  error {row['map_error']:.3f} m  C/N {row['c_per_n']:.3f}  "
        f"NEES/dof {row['nees_per_dof']:.2f}"
    )
    return row


def planners(pool, runs: int, jobs: int) -> list[dict]:
    """Two robots, calibrated noise; the first row is the paper's experiment, whose whole time is told."""
    explore_many(mission(until=2), 2, 0, pool)  # kernels compiled
    rows = []
    for how in ("known", "jcbb", "nn"):
        for planner in ("paper", "area", "coverage", "loop", "joint"):
            begun = time.perf_counter()
            rows.append(row_of(f"{planner}, {how}", explore_many(mission(planner, how=how), runs, 0, pool)))
            rows[-1]["seconds"] = time.perf_counter() - begun
            if len(rows) == 1:
                print(f"{runs} runs of the paper's experiment: {rows[0]['seconds']:.1f} s with {jobs} processes")
    rows.append(row_of("loop, 296 steps", explore_many(mission("loop", until=296), runs, 0, pool)))
    rows.append(row_of("paper, one robot", explore_many(mission(robots=1), runs, 0, pool)))
    rows.append(row_of("loop, one robot", explore_many(mission("loop", robots=1), runs, 0, pool)))
    rows.append(row_of("joint, 296 steps", explore_many(mission("joint", until=296), runs, 0, pool)))
    rows.append(row_of("joint, one robot", explore_many(mission("joint", robots=1), runs, 0, pool)))
    return rows


def scaling(pool, runs: int) -> dict:
    """2, 4 and 8 robots on four times the field: the exponent with which steps fall."""
    rows = [
        row_of(f"coverage, {k} robots, large field", explore_many(mission("coverage", k, "yuan-large"), runs, 0, pool))
        for k in (2, 4, 8)
    ]
    steps = [r["steps_mean"] for r in rows]
    exponent = float(-np.polyfit(np.log([2, 4, 8]), np.log(steps), 1)[0])
    print(
        f"steps fall as 1 / robots^{exponent:.2f}; 2 to 4: {np.log2(steps[0] / steps[1]):.2f}, 4 to 8: "
        f"{np.log2(steps[1] / steps[2]):.2f}"
    )
    return {"rows": rows, "exponent": exponent}


def hardship(pool, runs: int) -> list[dict]:
    """A fifth of the messages lost; one robot of four dead at a third of the run."""
    return [
        row_of("loop, 20 % of messages lost", explore_many(mission("loop", drop=0.2), runs, 0, pool)),
        row_of("coverage, robot 2 of 4 dead at 40", explore_many(mission("coverage", 4, kills={1: 40}), runs, 0, pool)),
        row_of("loop, robot 2 of 4 dead at 40", explore_many(mission("loop", 4, kills={1: 40}), runs, 0, pool)),
        row_of("joint, 20 % of messages lost", explore_many(mission("joint", drop=0.2), runs, 0, pool)),
        row_of("joint, robot 2 of 4 dead at 30", explore_many(mission("joint", 4, kills={1: 30}), runs, 0, pool)),
        row_of("paper, robot 2 of 2 dead at 100", explore_many(mission(kills={1: 100}), runs, 0, pool)),
    ]


if __name__ == "__main__":
    main()
