"""What all reproduced papers have in common: sections of tables and figures, differences, claims and verdicts on them.

A rule asks something of every number that the run has for a claim. All of them as asked: it holds; half of them or
more: in part; fewer: it does not hold. Of what the paper leaves open the words are answered, in part, not answered.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf
from pathlib import Path
from typing import ClassVar, Literal, cast

from ..io.directory import write_json
from ..report.html import Page
from ..report.result import HasMetrics, ResultBase, Rows
from ..report.style import Target

Verdict = Literal["holds", "in part", "does not hold", "answered", "not answered"]
Numbers = Mapping[str, Sequence[float]]
HALF = 0.5  # of the numbers that are as asked, for "in part"


@dataclass(frozen=True, slots=True)
class Check:
    """What is asked of every number that `Reproduction.numbers` has under a name: to be within `least` and `most`.

    says: what the numbers are, in words that the bounds follow.
    """

    name: str
    says: str
    least: float = -inf
    most: float = inf

    @property
    def text(self) -> str:
        if isinf(self.most):
            return f"{self.says} ≥ {self.least:g}"
        return f"{self.says} ≤ {self.most:g}" if isinf(self.least) else f"{self.says} {self.least:g} to {self.most:g}"

    def passed(self, numbers: Numbers) -> list[bool]:
        """Of each number whether it is as asked; what is not a number is not."""
        return [bool(self.least <= v <= self.most) for v in numbers[self.name]]


@dataclass(frozen=True, slots=True)
class Rule:
    """A verdict by numbers. enough: the share of them that must be as asked; question: left open by the paper."""

    checks: tuple[Check, ...]
    enough: float = 1.0
    question: bool = False

    @property
    def text(self) -> str:
        told = "; ".join(check.text for check in self.checks)
        return told if self.enough >= 1.0 else f"{told} ({self.enough:.0%} of them are enough)"

    def verdict(self, numbers: Numbers) -> Verdict:
        passed = [ok for check in self.checks for ok in check.passed(numbers)]
        if passed and sum(passed) >= self.enough * len(passed):
            return "answered" if self.question else "holds"
        if passed and sum(passed) >= HALF * len(passed):
            return "in part"
        return "not answered" if self.question else "does not hold"


@dataclass(frozen=True, slots=True)
class Typed:
    """A word that no number can change: of a proof, which a test holds, or of a drawing, for a reader to look at."""

    word: Verdict
    text: Literal["a proof, held by the test", "a drawing"]

    def verdict(self, numbers: Numbers) -> Verdict:  # noqa: ARG002
        return self.word


def rule(*checks: Check, enough: float = 1.0) -> Rule:
    """For a claim of the paper."""
    return Rule(checks, enough)


def question(*checks: Check) -> Rule:
    """For what the paper leaves open or assumes."""
    return Rule(checks, question=True)


CLAIMS_HEAD = (
    "claim of the paper", "in the code", "held by", "printed", "here", "verdict", "judged by", "over", "command",
)  # fmt: skip
JUDGED = (
    "A claim holds where every number measured for it is as the column 'judged by' asks, holds in part where half of "
    "them are, and else does not hold."
)
CLAIMS_FILE = "claims.md"
TABLES_FOLDER = "tables"


@dataclass(frozen=True, slots=True)
class Drawing:
    """One figure: the file it goes to under `figures/`, its caption, and what draws it."""

    file: str
    caption: str
    draw: Callable[[Target], object]


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with a table (none where `head` is empty), sentences before it and figures after it.

    file: the table's own in Markdown, under `tables/` and without its ending.
    """

    title: str
    head: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    drawings: Sequence[Drawing] = ()
    text: str = ""
    file: str = ""


@dataclass(frozen=True, slots=True)
class Claim:
    """One statement of a paper and what became of it.

    code: a file under `src/mapweave`; test: `file::function` under `tests`; printed: the paper's figure; here: the
    name under which `Reproduction.measured` gives ours; rule: how `Reproduction.numbers` tell whether it holds; over:
    how many draws ours is of, with `measured` names in braces, where not as many as of most.
    """

    claim: str
    code: str
    test: str
    printed: str
    here: str
    rule: Rule | Typed
    over: str = ""


class Reproduction(ResultBase):
    """Base of what `reproduce` gives. A subclass has `metrics` too.

    title: head of the page, who and when; claims: the paper's statements; command: what prints them; over: how many
    draws most of our figures are of; quick: fewer draws were asked for.
    """

    __slots__ = ()
    title: ClassVar[str]
    claims: ClassVar[tuple[Claim, ...]]
    command: ClassVar[str]
    over: ClassVar[str]
    quick: bool

    @property
    @abstractmethod
    def lead(self) -> str:
        """One line: what was run, how often."""

    @property
    def form(self) -> str:
        """What was added to the command: " --quick", or nothing."""
        return " --quick" if self.quick else ""

    @property
    def warning(self) -> str:
        """What a reader must know before any figure; empty where there is nothing."""
        return ""

    @abstractmethod
    def sections(self) -> tuple[Section, ...]:
        """Tables and figures in the order of the page."""

    @abstractmethod
    def differences(self) -> tuple[str, ...]:
        """What differs from the print, and why, in sentences."""

    @abstractmethod
    def measured(self) -> Mapping[str, str]:
        """Figures of this run by the names that `claims` uses."""

    @abstractmethod
    def numbers(self) -> Numbers:
        """What verdicts go by, by the names that the rules of `claims` use."""

    def claims_table(self) -> Rows:
        """Head and rows of the closing table."""
        told, numbers = self.measured(), self.numbers()
        rows = [
            (
                *(c.claim, c.code, c.test, c.printed, told[c.here], c.rule.verdict(numbers), c.rule.text),
                *((c.over or self.over).format_map(told), self.command + self.form),
            )
            for c in self.claims
        ]
        return CLAIMS_HEAD, rows

    def headline(self) -> Rows:
        first = next(s for s in self.sections() if s.head)
        return first.head, first.rows

    def lines(self) -> list[str]:
        return [f"{self.title}: {self.lead}", *self.differences()]

    def write_into(self, folder: Path) -> None:
        """`report.html`, `figures/*.png`, `metrics.json`; every table, and the closing one, in Markdown."""
        page = Page(self.title, self.lead)
        if self.warning:
            page.text(self.warning, warn=True)
        for section in self.sections():
            page.section(section.title)
            if section.text:
                page.text(section.text)
            if section.head:
                page.table(section.head, section.rows)
            for drawing in section.drawings:
                drawing.draw(folder / "figures" / drawing.file)
                page.figure(folder / "figures" / drawing.file, drawing.caption)
        page.section("What differs, and why")
        for sentence in self.differences():
            page.text(sentence)
        page.section("Claim by claim")
        page.text(JUDGED)
        page.table(*self.claims_table())
        page.write(folder / "report.html")
        self._write_tables(folder)
        write_json(folder / "metrics.json", cast("HasMetrics", self).metrics)

    def _write_tables(self, folder: Path) -> None:
        (folder / TABLES_FOLDER).mkdir(exist_ok=True)
        for section in self.sections():
            if section.head:
                text = markdown(section.head, section.rows)
                (folder / TABLES_FOLDER / f"{section.file}.md").write_text(text, encoding="utf-8")
        (folder / CLAIMS_FILE).write_text(markdown(*self.claims_table()), encoding="utf-8")


def markdown(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; files, tests and commands in code type."""
    marked = {"in the code", "held by", "command"}
    told = [[f"`{v}`" if name in marked else v for name, v in zip(head, row, strict=True)] for row in rows]
    return "".join(f"{_row(cells)}\n" for cells in (head, ["---"] * len(head), *told))


def sentences(text: str, **figures: object) -> tuple[str, ...]:
    """Paragraphs of `text`, each on one line, with the `figures` filled in."""
    return tuple(" ".join(part.split()) for part in text.format(**figures).strip().split("\n\n"))


def _row(cells: Sequence[object]) -> str:
    return "| " + " | ".join("" if cell is None else str(cell).replace("|", "\\|") for cell in cells) + " |"
