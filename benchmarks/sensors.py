"""How well each kind of sensor places robots on which data, from tables that are measured: prints one of them all.

    MAPWEAVE_DATA=.. python benchmarks/sensors.py

Every number is read from `docs/figures`, where each measured table stands with its command; minutes are those of the
logs, so that CPU seconds are told a minute of log.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from docs_figures import read_record

from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.laser_logs import read_laser
from mapweave.io.pyfg import read_pyfg
from mapweave.io.range_bags import read_range_bag

DATA = Path(os.environ.get("MAPWEAVE_DATA", "."))
RADIOS = {"n_7": "turtle01", "n_3": "turtle03", "n_4": "turtle04", "n_5": "turtle05"}
MINUTE = 60.0  # [s]


def of_team(path: Path) -> float:
    spans = [log.span for log in read_landmark_logs(path)]
    return max(end for _, end in spans) - min(begin for begin, _ in spans)


def of_scans(path: Path) -> float:
    return float(np.ptp(read_laser(path, "1").scan_t))


def of_radios(path: Path) -> float:
    log = read_range_bag(path, RADIOS if "four" in path.name else None)
    return max(float(np.ptp(way.t)) for way in log.odometry.values())


def of_graph(path: Path) -> float:
    t = read_pyfg(path).network.t
    return float(np.nanmax(t) - np.nanmin(t))


@dataclass(frozen=True, slots=True)
class Row:
    """One row: cells of the row of the record `name` that begins with `begins`.

    accuracy: words before each of its columns; log, seconds: of what the CPU is told by the minute, that of all rows of
    the same first cell, which are steps of one run.
    """

    sensor: str
    data: str
    name: str
    begins: tuple[str, ...]
    accuracy: dict[str, str]
    nees: str = ""
    log: str = ""
    seconds: Callable[[Path], float] | None = None

    def cells(self) -> list[str]:
        record = read_record(self.name)
        if record is None:
            raise SystemExit(f"{self.name}: not measured yet")
        head, _, *rows = (
            [cell.strip() for cell in line.strip().strip("|").split("|")]
            for line in record.table.splitlines()
            if line.startswith("|")
        )
        found = [cells for cells in rows if tuple(cells[: len(self.begins)]) == self.begins]
        if len(found) != 1:
            raise SystemExit(f"{self.name}: expected one row {self.begins}, found {len(found)}")
        told = dict(zip(head, found[0], strict=True))
        cpu = ""
        if self.seconds is not None:
            spent = sum(float(cells[head.index("CPU [s]")]) for cells in rows if cells[0] == self.begins[0])
            cpu = f"{spent / (self.seconds(DATA / self.log) / MINUTE):.2g}"
        accuracy = ", ".join(f"{word} {told[column]}".strip() for column, word in self.accuracy.items())
        link = f"[{self.name}]({record.page.removeprefix('docs/')})"
        return [self.sensor, self.data, accuracy, told[self.nees] if self.nees else "", cpu, link]


def team(sensors: str, name: str, number: int) -> Row:
    told = {"landmark RMSE": "landmarks", "mean ATE": "trajectories"}
    log, begins = f"mrclam/MRCLAM_Dataset{number}.zip", (str(number), "smoothed")
    return Row(sensors, f"MRCLAM {number}, five robots", name, begins, told, "NEES / dof", log, of_team)


def laser(data: str, log: str) -> Row:
    name, told = "logs of all kinds", {"distances [m]": ""}
    return Row("laser, wheels", data, name, (data, "0"), told, "", f"carmen/{log}", of_scans)


def ranges(data: str, begins: str, log: str = "", seconds: Callable[[Path], float] | None = None) -> Row:
    nees = "" if log else "NEES / dof"
    return Row("ranges, wheels", data, "ranges", (begins,), {"ATE [m]": "trajectories"}, nees, log, seconds)


def laid(sensors: str, data: str, name: str, *begins: str) -> Row:
    of = f"{sensors}, wheels, fixes of {begins[2]} m"
    return Row(of, f"simulated {data}", name, begins, {"trajectory [m]": "trajectories"}, "NEES / dof")


SETS = (1, 3, 4, 6)
ROWS = (
    *(team("cameras, wheels", "team smoothing", n) for n in SETS),
    *(team("cameras alone", "without wheels", n) for n in SETS),
    laser("Intel", "intel.clf.gz"),
    laser("CSAIL", "mit-csail.clf.gz"),
    ranges("tiers, four robots", "tiers", "uwb/tiers.pyfg.gz", of_graph),
    ranges("two turtlebots", "two turtlebots", "uwb/two-turtlebots.db3", of_radios),
    ranges("four turtlebots", "four turtlebots", "uwb/four-turtlebots.db3", of_radios),
    ranges("simulated, five robots", "simulated, 20% round something"),
    laid("laser", "office", "fixes", "office", "119", "2", "3"),
    laid("cameras", "team of four", "fixes of teams", "landmarks", "4", "2", "3"),
    laid("laser and camera", "team of two", "fixes of teams", "laser and camera", "2", "2", "3"),
    laid("ranges", "team of three", "fixes of radios", "odometry as believed", "3", "2", "3"),
)


def main() -> None:
    print("| sensors | data | error [m] | NEES / dof | CPU [s] a minute | table |")
    print("|" + "---|" * 6)
    for row in ROWS:
        print(f"| {' | '.join(row.cells())} |")


if __name__ == "__main__":
    main()
