"""The closing tables of the methods' pages: every claim points to code and a test that are there."""

import re
from pathlib import Path
from typing import get_args

import pytest

from mapweave.papers.hamatani.reproduce import CLAIMS as HAMATANI
from mapweave.papers.hara.reproduce import CLAIMS as HARA
from mapweave.papers.kojima.reproduce import CLAIMS as KOJIMA
from mapweave.papers.reproduction import CLAIMS_HEAD, Typed, Verdict, markdown
from mapweave.papers.yuan.reproduce import CLAIMS as YUAN

TOP = Path(__file__).parent.parent.parent
PAGES = {
    "relative-fusion.md": KOJIMA,
    "intensity-laser.md": HARA,
    "bearing-swarm.md": HAMATANI,
    "active-exploration.md": YUAN,
}
EVERY = [pytest.param(page, claim, id=f"{page}:{claim.here}") for page, claims in PAGES.items() for claim in claims]


@pytest.mark.parametrize(("page", "claim"), EVERY)
def test_a_claims_code_test_and_command_are_there(page, claim):
    assert (TOP / "src" / "mapweave" / claim.code).is_file()
    file, name = claim.test.split("::")
    assert re.search(rf"^def {name}\(", (TOP / "tests" / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert claim.command.split()[0] in {"reproduce", "explore", "localize"}


def test_a_word_is_typed_of_a_proof_and_of_a_drawing_alone():
    typed = {claim.here: claim.rule.text for claims in PAGES.values() for claim in claims if type(claim.rule) is Typed}
    assert typed == {"drawn": "a drawing", "independent": "a proof, held by the test"}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_ends_in_the_table_that_its_command_writes(page):
    text = (TOP / "docs" / "methods" / page).read_text(encoding="utf-8")
    closing = re.findall(r"<!-- \w+ claims: begin -->\n(.*?)<!-- \w+ claims: end -->", text, re.DOTALL)[-1]
    table = [line for line in closing.splitlines() if line.startswith("|")]
    assert text.rstrip().endswith(" claims: end -->")
    assert len(table) == len(PAGES[page]) + 2
    assert table[0] == markdown(CLAIMS_HEAD, []).splitlines()[0]
    for line, claim in zip(table[2:], PAGES[page], strict=True):
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert cells[:4] == [claim.claim, f"`{claim.code}`", f"`{claim.test}`", claim.printed]
        assert cells[5] in get_args(Verdict)
        assert cells[6] == claim.rule.text
        assert cells[8] in {f"`{claim.command}`", f"`{claim.command} --quick`"}
        assert cells[4]


def test_cells_of_a_table_cannot_break_it():
    assert markdown(("a", "command"), [("x | y", "z")]) == "| a | command |\n| --- | --- |\n| x \\| y | `z` |\n"
