"""The Intel log by every method: error on its known relations, of all and of those between exact stamps, CPU seconds.

MAPWEAVE_DATA=.. python benchmarks/laser_real.py [--seeds 3]
"""

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

from mapweave.evaluation.trajectory import exact_pairs, score_relations
from mapweave.io.landmark_truth import read_relations
from mapweave.io.laser_logs import read_laser
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser

COMPILING = 200  # scans that are mapped before, so that compiling is not timed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="of the particle filter, which alone draws")
    args = parser.parse_args()
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "carmen"
    log, known = read_laser(folder / "intel.clf.gz"), read_relations(folder / "intel.relations.gz")
    print("| method | seed | all relations | exact stamps | CPU |")
    print("|---|---|---|---|---|")
    short = replace(log, scan_t=log.scan_t[:COMPILING], scans=log.scans[:COMPILING])
    for method in ("graph", "particle", "gated"):
        map_laser(short, LaserConfig(method=method), 0)
    for method, seed in (("graph", 0), *(("particle", s) for s in range(args.seeds)), ("gated", 0)):
        begun = time.process_time()
        made = map_laser(log, LaserConfig(method=method), seed)
        spent = time.process_time() - begun
        exact = known.select(exact_pairs(known, log.scan_t, made.scans.host))
        every, sure = (score_relations(made.track, r).trans_mean for r in (known, exact))
        print(f"| `{method}` | {seed} | {every:.4f} m | {sure:.4f} m | {spent:.1f} s |", flush=True)


if __name__ == "__main__":
    main()
