"""How every `mapweave reproduce PAPER` tells its result."""

from pathlib import Path
from typing import TYPE_CHECKING

from .terminal import say, say_table

if TYPE_CHECKING:
    from ..papers.reproduction import Reproduction


def say_reproduction(result: "Reproduction", out: Path | None) -> None:
    """Tables, differences and claims on stdout, and where the page is."""
    say(f"{result.title}: {result.lead}\n")
    if result.warning:
        say(f"{result.warning}\n")
    for section in result.sections():
        if not (section.head or section.text):
            continue
        say(section.title)
        if section.text:
            say(section.text)
        if section.head:
            say_table(section.head, section.rows)
        say()
    say("What differs, and why")
    for sentence in result.differences():
        say(f"- {sentence}")
    say("\nClaim by claim")
    _, rows = result.claims_table()
    for claim, code, test, printed, here, over, command in rows:
        say(f"- {claim}: printed {printed}; here {here}, over {over} ({command}; {code}, {test})")
    if out is not None:
        say(f"\nreport: {out / 'report.html'}")
