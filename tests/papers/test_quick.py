"""`reproduce PAPER --quick` comes to the verdicts of the methods' pages, which the whole run writes."""

import re
from pathlib import Path

import pytest

from mapweave.papers.hamatani.reproduce import reproduce_hamatani
from mapweave.papers.hara.reproduce import reproduce_hara
from mapweave.papers.kojima.reproduce import reproduce_kojima
from mapweave.papers.yuan.reproduce import reproduce_yuan

METHODS = Path(__file__).parent.parent.parent / "docs" / "methods"
PAGES = {
    "relative-fusion.md": reproduce_kojima,
    "intensity-laser.md": reproduce_hara,
    "bearing-swarm.md": reproduce_hamatani,
    "active-exploration.md": reproduce_yuan,
}


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES)
def test_quick_comes_to_the_verdicts_of_the_page(page):
    text = (METHODS / page).read_text(encoding="utf-8")
    closing = re.findall(r"<!-- \w+ claims: begin -->\n(.*?)<!-- \w+ claims: end -->", text, re.DOTALL)[-1]
    rows = [line.strip("|").split(" | ") for line in closing.splitlines() if line.startswith("|")][2:]
    told = {row[0].strip(): row[5].strip() for row in rows}
    quick = PAGES[page](quick=True)
    head, found = quick.claims_table()
    claim, verdict = head.index("claim of the paper"), head.index("verdict")
    assert {row[claim]: row[verdict] for row in found} == told
