"""The closing table of a paper's page is replaced by the one that `mapweave reproduce PAPER --out DIR` wrote.

python benchmarks/claims.py docs/methods/relative-fusion.md DIR
"""

import argparse
from datetime import UTC, datetime
from pathlib import Path

import docs_figures
from docs_tables import TABLES

from mapweave.papers.reproduction import CLAIMS_FILE


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("page", type=Path)
    ask.add_argument("result", type=Path)
    said = ask.parse_args()
    table = (said.result / CLAIMS_FILE).read_text(encoding="utf-8").strip()
    name = said.page.resolve().relative_to(docs_figures.TOP).as_posix()
    known = next((t for t in TABLES if t.page == name and t.written == CLAIMS_FILE), None)
    if known is None:
        ask.error(f"{name}: no table of claims in docs_tables.py")
    today, commit = f"{datetime.now(UTC):%Y-%m-%d}", docs_figures.git("rev-parse", "--short", "HEAD")
    docs_figures.write(docs_figures.Record(known.name, name, known.told, today, commit, table, run=True))


if __name__ == "__main__":
    main()
