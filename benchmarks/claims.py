"""The closing table of a paper's page is replaced by the one that `mapweave reproduce PAPER --out DIR` wrote.

python benchmarks/claims.py docs/methods/relative-fusion.md DIR
"""

import argparse
from pathlib import Path

from mapweave.papers.reproduction import CLAIMS_FILE

HEADING = "## Claim by claim"


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("page", type=Path)
    ask.add_argument("result", type=Path)
    said = ask.parse_args()
    text = said.page.read_text(encoding="utf-8").split(HEADING)[0].rstrip()
    table = (said.result / CLAIMS_FILE).read_text(encoding="utf-8")
    said.page.write_text(f"{text}\n\n{HEADING}\n\n{table}", encoding="utf-8")


if __name__ == "__main__":
    main()
