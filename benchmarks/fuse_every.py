"""What `--fuse-every` costs against the number of updates, on a simulated team; how far its maps are from whole ones.

    python benchmarks/fuse_every.py [--minutes 10] [--robots 5] [--seed 1] [--updates 25,50,100,200,400]

Seconds of processor time of the filters' one pass and of all fusions, the exponent of the latter against the updates,
how often everything was judged anew, and the largest distance of a landmark on the way from where fusing the same maps
as a whole puts it, as a share of its standard deviation. The last map is that of a run without the option.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from mapweave import simulate_landmarks
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.fusion.online import OnlineFuser
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import grow


def run(logs: list, updates: int) -> tuple[float, float, int, float]:
    """Seconds of the filters, seconds of all fusions, judgements, and the largest distance in standard deviations."""
    spans = [log.span for log in logs]
    times = np.linspace(min(a for a, _ in spans), max(b for _, b in spans), updates + 1)[1:].tolist()
    began = time.process_time()
    grown = [grow(log, EkfSlamConfig(), times) for log in logs]
    filtered = time.process_time()
    fuser, states = OnlineFuser(), []
    for k in range(updates):
        fresher = [g.maps[k] for g in grown if g.maps[k] is not None]
        if fresher:
            fuser = fuser.update(*fresher)
            states.append(fuser)
    done = time.process_time()
    worst = 0.0
    for state in states[:: max(1, len(states) // 20)]:
        whole = fuse(list(state.latest.values()), FuseConfig()).components[0].map
        if state.largest is not None and state.largest.map.ids == whole.ids and len(whole):
            sd = np.sqrt(np.diag(whole.cov)).reshape(-1, 2)
            worst = max(worst, float((np.abs(state.largest.map.mean - whole.mean) / sd).max()))
    return filtered - began, done - filtered, fuser.judged, worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--robots", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--updates", default="25,50,100,200,400")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / "team"
        simulate_landmarks(where, robots=args.robots, minutes=args.minutes, seed=args.seed)
        logs = list(read_landmark_logs(where, None))
    counts = [int(n) for n in args.updates.split(",")]
    run(logs, 3)
    print(f"{'updates':>8} {'filters [s]':>12} {'fusions [s]':>12} {'judged':>7} {'off [sd]':>9}")
    spent = []
    for n in counts:
        filters, fusions, judged, worst = run(logs, n)
        spent.append(fusions)
        print(f"{n:8d} {filters:12.2f} {fusions:12.2f} {judged:7d} {worst:9.2f}", flush=True)
    if len(counts) > 1:
        print(f"fusions grow with the updates to the power {np.polyfit(np.log(counts), np.log(spent), 1)[0]:.2f}")


if __name__ == "__main__":
    main()
