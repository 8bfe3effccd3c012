"""Logs whose wheels or scanner are not as the log says: what is found of it, and how good the map is all the same.

    MAPWEAVE_DATA=.. python benchmarks/laser_calibration.py [--log NAME]... [--fault NAME]...

A row a log and a fault planted in it: what was planted beside what was found with its standard error (of the difference
to what the log as it is tells of itself), what of it the map was made with, and how far off the map is beside that of
the log as it is. Simulated logs: the root mean square distance [m] from the truth after one rigid alignment. Intel: the
mean error [m] on the known relations. The others: the mean distance [m] of the scanner from where the map of the log as
it is has it, after one rigid alignment.
"""

import argparse
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from laser_mistakes import Change, ranges, raw, scans, steps

from mapweave.api.map_laser import first_part
from mapweave.core import se2
from mapweave.core.errors import MapweaveError
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.evaluation.trajectory import score_relations
from mapweave.io.landmark_truth import read_relations
from mapweave.io.laser_logs import read_laser
from mapweave.laser.laser_map import LaserMap
from mapweave.laser.odometry_calibration import PARAMETERS
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import simulate_corridor, simulate_office


class Fault(NamedTuple):
    """change: what is done to the log; name: of the parameter that tells it, "" where none does; by: what is found then
    is that of the log as it is plus this, or times this where it is a factor.
    """

    change: Change
    name: str = ""
    by: float = 0.0


def moved(*by: float) -> Change:
    return scans(lambda s: replace(s, T_robot_sensor=s.T_robot_sensor + np.array(by)))


FAULTS = {
    "scanner turned by 0.15 rad": Fault(moved(0.0, 0.0, 0.15), "sensor_yaw", -0.15),
    "scanner 0.2 m ahead": Fault(moved(0.2, 0.0, 0.0), "sensor_x", -0.2),
    "scanner 0.1 m to the left": Fault(moved(0.0, 0.1, 0.0), "sensor_y", -0.1),
    "scans stamped 0.3 s late": Fault(scans(lambda s: replace(s, t=s.t + 0.3)), "lag", 0.3),
    "ways of the wheels times 1.03": Fault(steps((1.03, 1.03, 1.0)), "speed_scale", 1 / 1.03),
    "turns of the wheels times 1.05": Fault(steps((1.0, 1.0, 1.05)), "turn_scale", 1 / 1.05),
    "ways of the wheels over 1000": Fault(steps((1e-3, 1e-3, 1.0)), "speed_scale", 1000.0),
    "ways of the wheels times 1000": Fault(steps((1e3, 1e3, 1.0))),
    "ranges in centimetres": Fault(ranges(lambda r: 100.0 * r, 100.0)),
    "ranges in millimetres": Fault(ranges(lambda r: 1000.0 * r, 1000.0)),
}


Error = Callable[[LaserMap, np.ndarray], float]
"""Of a map whose log said so of the scanner's mounting."""


class Case(NamedTuple):
    """log; error: from the map of the log as it is that of any other."""

    log: LaserLog
    error: Callable[[LaserMap], Error]


def from_truth(truth: Track) -> Callable[[LaserMap], Error]:
    def error(made: LaserMap, _: np.ndarray) -> float:
        t = truth.t[(truth.t >= made.track.t[0]) & (truth.t <= made.track.t[-1])]
        p, q = (se2.interpolate(t, one.t, one.pose)[:, :2] for one in (made.track, truth))
        return float(np.sqrt(((se2.act(se2.align(p, q), p) - q) ** 2).sum(axis=1).mean()))

    return lambda _: error


def from_right(log: LaserLog) -> Callable[[LaserMap], Error]:
    def scanner(made: LaserMap, stated: np.ndarray) -> np.ndarray:
        known = made.odometry_calibration
        change = np.zeros(3) if known is None else known.used()[5:]
        return np.asarray(se2.compose(made.scans.pose, stated + change))[:, :2]

    def against(right: LaserMap) -> Error:
        q = scanner(right, np.array(log.scans[0].T_robot_sensor))

        def error(made: LaserMap, stated: np.ndarray) -> float:
            p = scanner(made, stated)
            return float(np.hypot(*(se2.act(se2.align(p, q), p) - q).T).mean())

        return error

    return against


def cases() -> dict[str, Callable[[], Case]]:
    data = Path(os.environ["MAPWEAVE_DATA"])

    def real(path: str, share: float = 1.0) -> Callable[[], Case]:
        def case() -> Case:
            log = first_part(read_laser(data / path), share)
            return Case(log, from_right(log))

        return case

    def intel() -> Case:
        relations = read_relations(data / "carmen" / "intel.relations.gz")
        log = first_part(read_laser(data / "carmen" / "intel.clf.gz"), 1 / 3)
        return Case(log, lambda _: lambda made, __: score_relations(made.track, relations).trans_mean)

    def simulated(simulate: Callable[..., object], seed: int) -> Callable[[], Case]:
        def case() -> Case:
            sim = simulate(seed=seed)
            return Case(sim.log, from_truth(sim.truth))

        return case

    return {
        "intel, first third": intel,
        "loop5": real("carmen/loop5.log.gz"),
        "exp1": real("urg04lx/exp1.dat.gz"),
        "mit-csail": real("carmen/mit-csail.clf.gz"),
        "fr-clinic, first fifth": real("carmen/fr-clinic.clf.gz", 0.2),
        "office 31": simulated(simulate_office, 31),
        "office 32": simulated(simulate_office, 32),
        "corridor 33": simulated(simulate_corridor, 33),
    }


def row(case: Case, fault: Fault, right: LaserMap) -> tuple[str, ...]:
    held = raw(case.log)
    fault.change(held)
    try:
        log = held.finish()
        made = map_laser(log, LaserConfig(method="graph"), 0)
    except MapweaveError as error:
        return "", "", "", "", "refused: " + str(error).rpartition(": ")[2]
    known, before = made.odometry_calibration, right.odometry_calibration
    found = away = used = ""
    if known is not None and before is not None:
        used = ", ".join(PARAMETERS[k] for k in np.flatnonzero(known.applied))
        if fault.name:
            k = PARAMETERS.index(fault.name)
            planted = before.value[k] * fault.by if k < 2 else before.value[k] + fault.by
            found = f"{planted:.4g}: {known.value[k]:.4g} ± {known.sd[k]:.2g}" if known.observed[k] else "not observed"
            away = f"{abs(known.value[k] - planted) / known.sd[k]:.1f}" if known.observed[k] else ""
    error = case.error(right)
    first, other = (error(m, np.array(one.scans[0].T_robot_sensor)) for m, one in ((right, case.log), (made, log)))
    return found, away, used, f"{first:.4f}", f"{other:.4f}"


def main() -> None:
    every = cases()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--log", action="append", choices=list(every), default=[])
    parser.add_argument("--fault", action="append", choices=list(FAULTS), default=[])
    args = parser.parse_args()
    print("| log | fault | planted: found | sd away | used | error as it is | error |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in args.log or every:
        case = every[name]()
        right = map_laser(raw(case.log).finish(), LaserConfig(method="graph"), 0)
        for fault in args.fault or FAULTS:
            print("|", " | ".join((name, fault, *row(case, FAULTS[fault], right))), "|", flush=True)


if __name__ == "__main__":
    main()
