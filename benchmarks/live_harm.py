"""A live team on a bad day: what is harmed, how often, and whether the map has the same bytes all the same.

    python benchmarks/live_harm.py [--sensor landmarks,laser] [--kills 50,8] [--still 30,10] [--seed 1]

Two robots drive a simulated log over links that are 500 ms late and lose a fifth of their packets, which TCP tells
again; the map process, a view and both robots are each killed `--kills` times at random moments and begun again, and
the map process stands still (SIGSTOP) for `--still` seconds in the end, as told for each sensor. The map is compared
with that of `mapweave map` of the same logs.
"""

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # processes and links are those of the tests
from tests.live.bad_network import LossyRelay, killed_at_random
from tests.live.processes import Fleet, same_result

from mapweave.api.map import map as map_logs
from mapweave.api.simulate import simulate_landmarks, simulate_laser
from mapweave.sim.laser_worlds import OfficeConfig

DELAY, LOSS = 0.5, 0.2  # [s], of packets
BETWEEN = 2.1  # [s] from a kill to the next, in the mean
LONGER = 1.3  # than all kills take, the drive is
PATIENCE = 900.0  # [s] for the rest of the drive


def logs(sensor: str, folder: Path, seed: int) -> tuple[list[Path], float]:
    """The log of each of two robots, and how long they drive [s]."""
    if sensor == "landmarks":
        simulate_landmarks(folder / "team", robots=2, minutes=1.0, seed=seed)
        return [folder / "team"] * 2, 60.0
    paths = [folder / f"{name}.mcap" for name in "ab"]
    for k, path in enumerate(paths):
        simulate_laser(path, OfficeConfig(rooms=1, visited=1), seed=seed + k)
    truth = np.loadtxt(paths[0].with_suffix(".truth.tum"))
    return paths, float(truth[-1, 0] - truth[0, 0])


def harmed(sensor: str, kills: int, seed: int, still: float) -> str:
    """A row: what was done, and what came of it; raises AssertionError where the map is another."""
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        sources, lasts = logs(sensor, folder, seed)
        map_logs(list(dict.fromkeys(sources)), folder / "direct")
        fleet = Fleet(folder, sources[0])
        relays = [LossyRelay(fleet.at, DELAY, LOSS, seed + k) for k in range(2)]
        rate = str(min(lasts / (4 * kills * BETWEEN * LONGER), 20.0))

        def robot(k: int) -> None:
            fleet.source = sources[k]
            fleet.robot(f"r{k + 1}", "--connect", relays[k].at, rate=rate)

        start = {
            "map": fleet.map,
            "view": lambda: fleet.start("view", "view", "--port", "0", "--connect", fleet.at),
            "r1": lambda: robot(0),
            "r2": lambda: robot(1),
        }
        begin = time.monotonic()
        try:
            killed = killed_at_random(fleet, start, kills, np.random.default_rng(seed))
            stopped = fleet.running["map"].poll() is None
            if stopped:
                fleet.running["map"].send_signal(signal.SIGSTOP)
                time.sleep(still)
                fleet.running["map"].send_signal(signal.SIGCONT)
            if fleet.wait("map", PATIENCE) != 0:
                raise SystemExit(fleet.said("map"))
            told = [line for name in start for line in fleet.said(name).splitlines() if "Traceback" in line]
        finally:
            fleet.end()
            for relay in relays:
                relay.close()
        same_result(folder / "direct", folder / "out-map", but=("report.html",))  # it tells how long a scan took
    each = ", ".join(f"{name} {killed[name]}" for name in start)
    lost = sum(relay.lost for relay in relays) / sum(relay.lost + relay.passed for relay in relays)
    return (
        f"| {sensor} | {each} | {100 * lost:.0f} % | {still if stopped else 0:.0f} s | {len(told)} |"
        f" the same bytes | {time.monotonic() - begin:.0f} s |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensor", default="landmarks,laser")
    parser.add_argument("--kills", default="50,8")
    parser.add_argument("--still", default="30,10")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    head = ["robots", "killed", "packets lost", "stood still", "tracebacks", "map", "took"]
    print(f"| {' | '.join(head)} |", "|---" * len(head) + "|", sep="\n", flush=True)
    rows = (words.split(",") for words in (given.sensor, given.kills, given.still))
    for sensor, kills, still in zip(*rows, strict=True):
        print(harmed(sensor, int(kills), given.seed, float(still)), flush=True)


if __name__ == "__main__":
    main()
