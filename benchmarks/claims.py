"""The tables of a paper's page are replaced by those that `mapweave reproduce PAPER --out DIR` wrote.

python benchmarks/claims.py PAPER DIR [--commit COMMIT]
"""

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

import docs_figures
from docs_tables import TABLES, reproduce


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("paper")
    ask.add_argument("result", type=Path)
    ask.add_argument("--commit", default="HEAD", help="at which the command was run")
    said = ask.parse_args()
    mine = [t for t in TABLES if t.command == reproduce(said.paper) and t.written.endswith(".md")]
    if not mine:
        ask.error(f"{said.paper}: no tables in docs_tables.py")
    if json.loads((said.result / "metrics.json").read_text(encoding="utf-8"))["quick"]:
        ask.error(f"{said.result}: of the quick form of the command")
    today, commit = f"{datetime.now(UTC):%Y-%m-%d}", docs_figures.git("rev-parse", "--short", said.commit)
    for table in mine:
        text = (said.result / table.written).read_text(encoding="utf-8").strip()
        docs_figures.write(docs_figures.Record(table.name, table.page, table.told, today, commit, text, run=True))


if __name__ == "__main__":
    main()
