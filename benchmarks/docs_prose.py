"""Numbers in sentences of the documentation that a measured table holds.

`<!-- figure: TABLE[ROW, COLUMN] -->0.034` says that 0.034 is what the table TABLE has in that cell, rounded as it is
written. ROW: what the row's cells begin with, joined by spaces, marks of emphasis and code left out. COLUMN: the head
of the column, or its number; `COLUMN#2` is the second number of a cell, `COLUMN x 100` the number times 100.

Any other number that has a unit or a decimal point, or counts (`9 of 10`, `300 steps`), stands in `docs_given.txt` with
the words around it: a parameter, a definition, what others print, never what was measured here. `python
benchmarks/docs_prose.py` counts them and tells what stands nowhere, exit status 1 where there is one; `--given` puts
that into the list.
"""

import argparse
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

NUMBER = r"-?\d[\d,]*(?:\.\d+)?"
FIGURE = re.compile(rf"(?<!`)(<!-- figure: ([^\[\]\n]+)\[((?:[^\[\]\n]|\[[^\]\n]*\])*)\] -->)({NUMBER})?")
BROKEN = re.compile(r"^[ >*-]*(<!-- figure: [^\n]*?-->)", re.MULTILINE)  # Markdown takes such a line for markup alone
PLACE = re.compile(r"^(.*), ([^,]+?)(?:#(\d+))?(?: x (\d+))?$")
Held = Callable[[str], str | None]  # the text of a table, None where there is none


GIVEN = Path(__file__).with_name("docs_given.txt")
FREE = re.compile(r"(?<![\w.-])-?(?:\d[\d,]*(?:\.\d+)?|\.\d+)(?!\w)")
UNITS = (
    "%|°|(?:m|cm|mm|s|ms|us|µs|ns|min|h|kB|MB|GB|kiB|MiB|GiB|times|deg|degrees|seconds|minutes|hours|metres|rad|mrad|points"
    "|steps|runs|pairs|trials|cases|teams|sightings|relations|closures|misreads)\\b"
    r"|(?:out\s+)?of\s+(?:some\s+|the\s+|all\s+)?\d"
)
UNIT = re.compile(rf"\s*(?:{UNITS})")
NO_PROSE = re.compile(
    r"^```.*?^```|^<!-- ([^:\n]+): begin -->.*?<!-- \1: end -->|^\|.*?$|^#.*?$|\$\$.*?\$\$|\$[^$\n]*(?:\n[^$\n]+)?\$"
    rf"|<!-- figure: [^\n]*?-->{NUMBER}|<!--.*?-->|`[^`\n]*(?:\n[^`\n]*)?`|\]\([^)]*\)",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True, slots=True)
class Free:
    """A number in a sentence that is tied to no table. words: the one before it, itself in brackets, the one after."""

    page: str
    line: int
    words: str


def pages(top: Path) -> list[Path]:
    return [top / "README.md"] * (top / "README.md").exists() + sorted(top.glob("docs/**/*.md"))


def look_up(text: str, place: str) -> float:
    """The number at `ROW, COLUMN[#K][ x FACTOR]` of a Markdown table; LookupError says what is not there."""
    parts = PLACE.match(place)
    if parts is None:
        raise LookupError(f"[{place}] is not [ROW, COLUMN]")
    row, column, which, factor = parts.groups()
    head, _, *rows = [_cells(line) for line in text.splitlines() if line.startswith("|")]
    at = head.index(column) if column in head else int(column) - 1 if column.isdigit() else len(head)
    if not 0 <= at < len(head):
        raise LookupError(f"no column {column!r}")
    found = [cells for cells in rows if " ".join(" ".join(cells).split()).startswith(row)]
    if len(found) > 1:  # whole cells before parts of one
        found = [c for c in found if any(" ".join(" ".join(c[: k + 1]).split()) == row for k in range(len(c)))] or found
    if len(found) != 1:
        raise LookupError(f"{len(found)} rows begin with {row!r}")
    numbers = re.findall(NUMBER, found[0][at])
    if len(numbers) < int(which or 1):
        raise LookupError(f"no number {which or 1} in {found[0][at]!r}")
    return float(numbers[int(which or 1) - 1].replace(",", "")) * float(factor or 1)


def written(value: float, like: str) -> str:
    """`value` with the digits and the commas of `like`."""
    digits = len(like.partition(".")[2])
    return f"{value:,.{digits}f}" if "," in like else f"{value:.{digits}f}"


def agrees(value: float, shown: str) -> bool:
    """Whether `shown` is `value` rounded to its digits, half up or down."""
    digits = len(shown.partition(".")[2])
    return abs(value - float(shown.replace(",", ""))) <= 0.5 * 10.0**-digits * (1 + 1e-9)


def stale_prose(top: Path, held: Held) -> list[str]:
    """Of every number in a sentence that its table does not hold, a sentence."""
    out = []
    for page in pages(top):
        said = page.read_text(encoding="utf-8")
        out += [
            f"{page.relative_to(top)}: {m[1]} begins its line, which ends the paragraph" for m in BROKEN.finditer(said)
        ]
        for _, table, place, shown in FIGURE.findall(said):
            where = f"{page.relative_to(top)}: {table}[{place}]"
            text = held(table)
            if text is None:
                out.append(f"{where}: no such table was measured")
                continue
            try:
                value = look_up(text, place)
            except LookupError as error:
                out.append(f"{where}: {error}")
                continue
            if not shown or not agrees(value, shown):
                out.append(f"{where}: the page says {shown or 'nothing'}, the table {value:g}")
    return out


def free_numbers(top: Path) -> list[Free]:
    """Every number of a sentence with a unit or a decimal point, or that counts, and that is tied to no table."""
    out = []
    for page in pages(top):
        text = NO_PROSE.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), page.read_text(encoding="utf-8"))
        for match in FREE.finditer(text):
            if "." not in match[0] and not UNIT.match(text, match.end()):
                continue
            before, after = text[: match.start()].split()[-1:], text[match.end() :].split(maxsplit=1)[:1]
            words = " ".join([*before, f"[{match[0]}]", *after])
            out.append(Free(page.relative_to(top).as_posix(), text.count("\n", 0, match.start()) + 1, words))
    return out


def listed(given: Path = GIVEN) -> dict[str, list[str]]:
    """What stands in the list: page -> words. ValueError: of a heading that is no page, or words under none."""
    out: dict[str, list[str]] = {}
    page = None
    for line in given.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            page = line[3:]
            if not page.endswith(".md"):
                raise ValueError(f"{given.name}: {page!r} is no page; what was measured belongs into a table")
            out[page] = []
        elif line and not line.startswith("#"):
            if page is None:
                raise ValueError(f"{given.name}: {line!r} stands under no page")
            out[page].append(line)
    return out


def unlisted(top: Path, given: Path = GIVEN) -> list[str]:
    """Of every number in a sentence that is neither tied to a table nor listed, a sentence."""
    held = listed(given)
    return [
        f"{free.page}:{free.line}: {free.words!r} is tied to no table and does not stand in {given.name}"
        for free in free_numbers(top)
        if free.words not in held.get(free.page, ())
    ]


def renew(top: Path, table: str, text: str) -> None:
    """Every sentence with a number of `table` says what `text` holds now."""

    def said(match: re.Match[str]) -> str:
        mark, name, place, shown = match.groups()
        if name != table or not shown:
            return match[0]
        value = look_up(text, place)
        return match[0] if agrees(value, shown) else mark + written(value, shown)

    for page in pages(top):
        before = page.read_text(encoding="utf-8")
        after = FIGURE.sub(said, before)
        if after != before:
            page.write_text(after, encoding="utf-8")


def _cells(line: str) -> list[str]:
    return [re.sub(r"[*`_]", "", cell).strip() for cell in line.strip().strip("|").split("|")]


def write_list(top: Path, given: Path = GIVEN) -> None:
    """The list names what stands in sentences and no table holds, page by page in the order of the pages."""
    head = given.read_text(encoding="utf-8").partition("\n\n")[0].splitlines()
    by_page: dict[str, list[str]] = {}
    for free in free_numbers(top):
        by_page.setdefault(free.page, []).append(free.words)
    for page, words in sorted(by_page.items()):
        head += ["", f"## {page}", *dict.fromkeys(words)]
    given.write_text("\n".join(head) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--given", action="store_true", help="put into the list what nobody measured")
    asked, top = parser.parse_args(), Path(__file__).parents[1]
    if asked.given:
        write_list(top)
    wrong = unlisted(top)
    print(f"given: {len(free_numbers(top)) - len(wrong)}")
    print("\n".join(wrong))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
