"""Real logs with received light, mapped with it, without it, with it at full weight whatever it tells, as in the paper.

MAPWEAVE_DATA=.. python benchmarks/light_real.py [--only NAME]...

Distances are those from the wheels, or from the commands integrated where a log has no wheels, both from the first
scan's pose; `contradict`: share of the steps from scan to scan that differ from the wheels' by more than three standard
deviations of 0.01 m + 10 %; `jump`: the largest such difference. Across and along: how thick walls are drawn, the
median over cells of 0.2 m of the standard deviation of returns from their line, of walls that face the robot's side
(thick where its motion across its heading errs) and of those that face its front or back (where that along it does).
`/map`: of the log that holds a map made by another program, the share of occupied cells, of 0.1 m, that lie within
0.1 m of a cell occupied there, after the rigid motion with which most do.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.spatial import cKDTree

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.io.laser_logs import read_laser
from mapweave.laser.beam import WHOLE, beams
from mapweave.laser.config import Feature
from mapweave.laser.laser_map import LaserMap
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature, contradicting, map_laser, map_session
from mapweave.mapping.session import LaserSession

# name, file, file whose odometry is the reference, whether wheels are left out of the run
LOGS = (
    ("Neato, bare wall", "neato_first_bag.bag", "neato_first_bag.bag", False),
    ("the same, wheels left out", "neato_first_bag.bag", "neato_first_bag.bag", True),
    ("LDS-01, maze", "tb3_jchee_maze.bag", "tb3_jchee_maze_cmdodom.clf.gz", False),
    ("the same, commands as wheels", "tb3_jchee_maze_cmdodom.clf.gz", "tb3_jchee_maze_cmdodom.clf.gz", False),
    ("LDS-01, wall", "tb3_khaidarovs_wall.bag", "tb3_khaidarovs_wall_cmdodom.clf.gz", False),
    ("the same, commands as wheels", "tb3_khaidarovs_wall_cmdodom.clf.gz", "tb3_khaidarovs_wall_cmdodom.clf.gz", False),
    ("LDS-01, panels", "tb3_riya_2000.bag", "tb3_riya_2000_cmdodom.clf.gz", False),
    ("the same, commands as wheels", "tb3_riya_2000_cmdodom.clf.gz", "tb3_riya_2000_cmdodom.clf.gz", False),
    ("LDS-01, another wall", "tb3_starchon_wall.bag", None, False),
)
CELL = 0.2  # [m] in which walls are straight
OCCUPIED, FULL = 64, 100  # of 100, from which a cell of another program's map is a wall, and what one of ours is
TURNS = 120  # headings tried to lay one map on another
NEAR = 0.1  # [m] a wall this near to one of the other map's agrees with it


def at_full_weight(log: LaserLog, cfg: LaserConfig) -> LaserMap | None:
    """The map with the light that was calibrated counting in full, whatever it is worth; None without calibration."""
    found = choose_feature(log, cfg).calibration
    if found is None:
        return None
    forced = Feature("normalised", replace(found, information=WHOLE))
    session = LaserSession(log.robot, cfg, 0, forced)
    for event in log.events():
        session.push(event)
    return map_session(session, log, forced, {"estimate": 0.0})


def thickness(made: LaserMap, log: LaserLog, cfg: LaserConfig) -> tuple[float, float]:
    """[mm] of walls to the robot's side and of those ahead or behind; nan without any."""
    returns = [beams(scan, "none", None, cfg.beam) for scan in log.scans]
    every = np.concatenate([se2.act(pose, b.s) for pose, b in zip(made.scans.pose, returns, strict=True)])
    faced = np.concatenate([b.normal[:, 0] ** 2 for b in returns])
    _, cell = np.unique(np.floor(every / CELL).astype(int), axis=0, return_inverse=True)
    order = np.argsort(cell.ravel(), kind="stable")
    cuts = np.flatnonzero(np.diff(cell.ravel()[order])) + 1
    sd: tuple[list[float], list[float]] = ([], [])
    for part, ahead in zip(np.split(every[order], cuts), np.split(faced[order], cuts), strict=True):
        if len(part) >= 20:
            thick = np.sqrt(max(np.linalg.eigvalsh(np.cov(part.T))[0], 0.0))
            sd[int(ahead.mean() > 0.5)].append(1e3 * thick)
    return float(np.median(sd[0] or np.nan)), float(np.median(sd[1] or np.nan))


def other_map(path: Path) -> np.ndarray | None:
    """(n, 2) middles [m] of the cells occupied in the last `/map` of a bag; None where it holds none."""
    if path.suffix != ".bag":
        path = path.with_name(path.name.replace("_cmdodom.clf.gz", ".bag"))
    with AnyReader([path]) as bag:
        kept = [c for c in bag.connections if c.topic == "/map"]
        grids = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages(kept)] if kept else []
    if not grids:
        return None
    info = grids[-1].info
    rows, cols = np.nonzero(np.asarray(grids[-1].data).reshape(info.height, info.width) > OCCUPIED)
    corner = np.array([info.origin.position.x, info.origin.position.y])
    return np.asarray(corner + info.resolution * (np.column_stack([cols, rows]) + 0.5))


def agreement(made: LaserMap, other: np.ndarray) -> float:
    """The greatest share of our occupied cells near those of `other` over `TURNS` headings, each laid on closely."""
    grid = made.grid
    rows, cols = np.nonzero(grid.to_numpy() == FULL)
    ours = grid.origin + grid.resolution * (np.column_stack([cols, rows]) + 0.5)
    tree = cKDTree(other)
    best = 0.0
    for heading in np.linspace(-np.pi, np.pi, TURNS, endpoint=False):
        turned = (ours - ours.mean(axis=0)) @ se2.rotation(float(heading)).T + other.mean(axis=0)
        for reach in (1.0, 1.0, 0.5, 0.5, 0.3, 0.3, 0.2, 0.2, 0.2, 0.15, 0.15, 0.15):
            distance, at = tree.query(turned)
            near = distance < reach
            if near.sum() < 3:
                break
            a, b = turned[near], other[at[near]]
            u, _, v = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
            flip = np.diag([1.0, np.linalg.det(u @ v)])
            turned = (turned - a.mean(axis=0)) @ (u @ flip @ v) + b.mean(axis=0)
        best = max(best, float(np.mean(tree.query(turned)[0] < NEAR)))
    return best


def row(made: LaserMap, log: LaserLog, reference: LaserLog | None, cfg: LaserConfig, other: np.ndarray | None) -> str:
    pose = se2.between(made.scans.pose[0], made.scans.pose)
    way = float(np.hypot(*np.diff(pose[:, :2], axis=0).T).sum())
    end = most = contradicts = jump = "-"
    if reference is not None and len(reference.scans) == len(pose):
        wheels = np.array([scan.odometry for scan in reference.scans], float)
        wheels = se2.between(wheels[0], wheels)
        apart = np.hypot(*(pose - wheels)[:, :2].T)
        step = se2.between(se2.between(wheels[:-1], wheels[1:]), se2.between(pose[:-1], pose[1:]))
        end, most, jump = (
            f"{apart[-1]:.2f} m",
            f"{apart.max():.2f} m",
            f"{np.hypot(step[:, 0], step[:, 1]).max():.2f} m",
        )
        contradicts = f"{100 * contradicting(pose, reference):.0f} %"
    thick = " | ".join("-" if np.isnan(mm) else f"{mm:.1f} mm" for mm in thickness(made, log, cfg))
    alike = "-" if other is None else f"{100 * agreement(made, other):.0f} %"
    return f"{made.feature} | {end} | {most} | {contradicts} | {jump} | {way:.1f} m | {thick} | {alike}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", default=[], help="a file's name")
    args = parser.parse_args()
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "light"
    print("| log | way to map | feature | end | largest | contradict | jump | way | across | along | /map |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name, file, truth, bare in LOGS:
        if args.only and file not in args.only:
            continue
        log = read_laser(folder / file)
        other = other_map(folder / file)
        reference = None if truth is None else read_laser(folder / truth)
        if bare:
            log = replace(log, odometry=None, scans=tuple(replace(scan, odometry=None) for scan in log.scans))
        cfg = LaserConfig(method="graph")
        ways = (
            ("default", lambda log=log, cfg=cfg: map_laser(log, cfg, 0)),
            ("geometry", lambda log=log, cfg=cfg: map_laser(log, replace(cfg, feature="none"), 0)),
            ("light at full weight", lambda log=log, cfg=cfg: at_full_weight(log, cfg)),
            ("Intensity-ICP, raw", lambda log=log: map_laser(log, LaserConfig(method="icp", feature="raw"), 0)),
        )
        for way, run in ways:
            made = run()
            told = (
                "not calibrated | - | - | - | - | - | - | - | -"
                if made is None
                else row(made, log, reference, cfg, other)
            )
            print(f"| {name} | {way} | {told} |", flush=True)


if __name__ == "__main__":
    main()
