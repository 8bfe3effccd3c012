"""Real logs with received light, mapped with it, without it, with it at full weight whatever it tells, as in the paper.

MAPWEAVE_DATA=.. python benchmarks/light_real.py [--only NAME]...

Distances are those from the wheels, or from the commands integrated where a log has no wheels, both from the first
scan's pose; `contradict`: share of the steps from scan to scan that differ from the wheels' by more than three standard
deviations of 0.01 m + 10 %; `jump`: the largest such difference. Across: how thick walls are drawn, the median over
cells of 0.2 m of the standard deviation of returns from their line.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

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


def thickness(made: LaserMap, log: LaserLog, cfg: LaserConfig) -> float:
    """[mm] of walls, across."""
    points = [
        se2.act(pose, beams(scan, "none", None, cfg.beam).s)
        for pose, scan in zip(made.scans.pose, log.scans, strict=True)
    ]
    every = np.concatenate(points)
    _, cell = np.unique(np.floor(every / CELL).astype(int), axis=0, return_inverse=True)
    order = np.argsort(cell.ravel(), kind="stable")
    parts = np.split(every[order], np.flatnonzero(np.diff(cell.ravel()[order])) + 1)
    sd = [np.sqrt(max(np.linalg.eigvalsh(np.cov(part.T))[0], 0.0)) for part in parts if len(part) >= 20]
    return 1e3 * float(np.median(sd)) if sd else float("nan")


def row(made: LaserMap, log: LaserLog, reference: LaserLog | None, cfg: LaserConfig) -> str:
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
    return (
        f"{made.feature} | {end} | {most} | {contradicts} | {jump} | {way:.1f} m | {thickness(made, log, cfg):.1f} mm"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", default=[], help="a file's name")
    args = parser.parse_args()
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "light"
    print("| log | way to map | feature | end | largest | contradict | jump | way | across |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, file, truth, bare in LOGS:
        if args.only and file not in args.only:
            continue
        log = read_laser(folder / file)
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
            told = "not calibrated | - | - | - | - | - | -" if made is None else row(made, log, reference, cfg)
            print(f"| {name} | {way} | {told} |", flush=True)


if __name__ == "__main__":
    main()
