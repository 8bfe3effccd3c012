"""How often `localize` is right, wrong or not sure when the start is searched everywhere.

    python benchmarks/localize_trust.py [--starts 100] [--seed 0] [--scans 60] [--json FILE]

The table of `reproduce hara` (`papers/hara/experiments.py`) alone, with starts and seeds of one's own.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from mapweave.papers.hara.experiments import SCANS, starts_table, try_starts
from mapweave.papers.reproduction import markdown


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--starts", type=int, default=100)
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--scans", type=int, default=SCANS)
    ask.add_argument("--json", type=Path)
    asked = ask.parse_args()
    starts = try_starts(asked.starts, asked.seed, asked.scans)
    print(markdown(*starts_table(starts)))
    if asked.json:
        asked.json.write_text(json.dumps([asdict(s) for s in starts], indent=1))


if __name__ == "__main__":
    main()
