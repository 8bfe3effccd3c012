"""The closing tables of the methods' pages: every claim points to code and a test that are there."""

import re
from pathlib import Path
from typing import get_args

import pytest

from mapweave.papers.hamatani.reproduce import HamataniReproduction
from mapweave.papers.hara.reproduce import HaraReproduction
from mapweave.papers.kojima.reproduce import KojimaReproduction
from mapweave.papers.reproduction import CLAIMS_HEAD, Typed, Verdict, markdown
from mapweave.papers.yuan.reproduce import YuanReproduction

TOP = Path(__file__).parent.parent.parent
PAGES = {
    "relative-fusion.md": KojimaReproduction,
    "intensity-laser.md": HaraReproduction,
    "bearing-swarm.md": HamataniReproduction,
    "active-exploration.md": YuanReproduction,
}
EVERY = [
    pytest.param(page, claim, id=f"{page}:{claim.here}") for page, paper in PAGES.items() for claim in paper.claims
]


@pytest.mark.parametrize(("page", "claim"), EVERY)
def test_a_claims_code_test_and_command_are_there(page, claim):
    assert (TOP / "src" / "mapweave" / claim.code).is_file()
    file, name = claim.test.split("::")
    assert re.search(rf"^def {name}\(", (TOP / "tests" / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert PAGES[page].command.split()[0] == "reproduce"


def test_a_word_is_typed_of_a_proof_and_of_a_drawing_alone():
    typed = {
        claim.here: claim.rule.text for paper in PAGES.values() for claim in paper.claims if type(claim.rule) is Typed
    }
    assert typed == {"drawn": "a drawing", "independent": "a proof, held by the test"}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_ends_in_the_table_that_its_command_writes(page):
    text = (TOP / "docs" / "methods" / page).read_text(encoding="utf-8")
    closing = re.findall(r"<!-- \w+ claims: begin -->\n(.*?)<!-- \w+ claims: end -->", text, re.DOTALL)[-1]
    table = [line for line in closing.splitlines() if line.startswith("|")]
    assert text.rstrip().endswith(" claims: end -->")
    assert len(table) == len(PAGES[page].claims) + 2
    assert table[0] == markdown(CLAIMS_HEAD, []).splitlines()[0]
    for line, claim in zip(table[2:], PAGES[page].claims, strict=True):
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert cells[:4] == [claim.claim, f"`{claim.code}`", f"`{claim.test}`", claim.printed]
        assert cells[5] in get_args(Verdict)
        assert cells[6] == claim.rule.text
        assert cells[8] in {f"`{PAGES[page].command}`", f"`{PAGES[page].command} --quick`"}
        assert cells[4]


def test_cells_of_a_table_cannot_break_it():
    assert markdown(("a", "command"), [("x | y", "z")]) == "| a | command |\n| --- | --- |\n| x \\| y | `z` |\n"
