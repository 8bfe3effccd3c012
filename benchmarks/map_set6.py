"""How long the whole command `mapweave map` takes on a real data set, everything included, in a process of its own.

python benchmarks/map_set6.py [DATASET.zip] [--runs 3]      default: mrclam/MRCLAM_Dataset6.zip under MAPWEAVE_DATA
The first run may compile; the table tells it from the later ones. Prints a table and JSON.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    home = Path(os.environ.get("MAPWEAVE_DATA", "."))
    parser.add_argument("dataset", nargs="?", type=Path, default=home / "mrclam" / "MRCLAM_Dataset6.zip")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as held:
        out = Path(held) / "result"
        for run in range(args.runs):
            began = time.perf_counter()
            words = ["map", str(args.dataset), "--out", str(out), "--jobs", str(args.jobs)]
            subprocess.run([sys.executable, "-m", "mapweave", *words], check=True, capture_output=True)
            wall = time.perf_counter() - began
            timing = json.loads((out / "metrics.json").read_text())["timing"]
            rows.append(
                {"run": run + 1, "wall": round(wall, 2), **timing, "elsewhere": round(wall - timing["total"], 2)}
            )
    head = list(rows[0])
    print("  ".join(f"{h:>9}" for h in head))
    for row in rows:
        print("  ".join(f"{row[h]:>9}" for h in head))
    print(json.dumps({"dataset": args.dataset.name, "cores": os.cpu_count(), "goal_s": 20.0, "runs": rows}))


if __name__ == "__main__":
    main()
