"""Writes the measured tables of the documentation, and keeps beside each what was measured, when, and at which commit.

    MAPWEAVE_DATA=... python benchmarks/docs_figures.py [--list] [--check] [--only NAME]... [--adopt NAME]... [--jobs N]

Without options every table is measured anew: hours. `--only` measures one. `--check` says which tables of the pages
are not those of `docs/figures/NAME.json`, exit status 1 where there is one. `--adopt` takes a table as it stands on its
page, with the date of the commit that put it there (of today where none did): for tables that were measured before. The
tables are listed in `docs_tables.py`; numbers in sentences that name a table (`docs_prose.py`) follow it. Every record
says whether its command was run at its commit (`run`) or the table was taken as it stood.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from docs_prose import renew, stale_prose
from docs_tables import CHECKED_ELSEWHERE, PYTHON, TABLES, Table

TOP = Path(__file__).resolve().parents[1]
MARK = re.compile(r"<!-- ([^:\n]+): begin -->\n(.*?)<!-- \1: end -->", re.DOTALL)
FOOT = re.compile(r"\n+(?:Measured|Written by) [^\n]*(?:\n(?!\n|\|)[^\n]*)*\s*$")


@dataclass(frozen=True, slots=True)
class Record:
    """What stands in `docs/figures/NAME.json`."""

    name: str
    page: str
    command: str
    date: str
    commit: str
    table: str
    run: bool = False  # whether the command was run at that commit; else the table was taken as it stood on the page

    @property
    def text(self) -> str:
        """What stands between the marks."""
        return f"{self.table}\n\nMeasured {self.date} at {self.commit} by `{self.command}`.\n"


def kept(name: str, top: Path = TOP) -> Path:
    return top / "docs" / "figures" / f"{re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')}.json"


def read_record(name: str, top: Path = TOP) -> Record | None:
    path = kept(name, top)
    return Record(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def on_page(table: Table, top: Path = TOP) -> str | None:
    """What stands between the table's marks; None where there are none."""
    page = (top / table.page).read_text(encoding="utf-8")
    return next((text for name, text in MARK.findall(page) if name == table.name), None)


def bare(text: str) -> str:
    """The table alone, without the line that says when it was measured."""
    return FOOT.sub("", text.strip()).strip()


def write(record: Record, top: Path = TOP) -> None:
    """The record beside, its text on the page."""
    kept(record.name, top).parent.mkdir(exist_ok=True)
    held = {name: getattr(record, name) for name in Record.__slots__}
    kept(record.name, top).write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    renew(top, record.name, record.table)
    if not record.page:
        return
    path = top / record.page
    begin, end = f"<!-- {record.name}: begin -->\n", f"<!-- {record.name}: end -->"
    before, _, rest = path.read_text(encoding="utf-8").partition(begin)
    after = rest.partition(end)[2]
    path.write_text(f"{before}{begin}{record.text}{end}{after}", encoding="utf-8")


def stale(top: Path = TOP, tables: tuple[Table, ...] = TABLES) -> list[str]:
    """Of every table that is not what was measured, and of every mark or record that belongs to none, a sentence."""
    out = []
    for table in tables:
        record = read_record(table.name, top)
        text = on_page(table, top) if table.page else record.text if record else ""
        if text is None:
            out.append(f"{table.page}: no marks <!-- {table.name}: begin --> and <!-- {table.name}: end -->")
        elif record is None and not text.strip():
            continue  # not measured yet: nothing that could be wrong
        elif record is None or (record.text, record.page, record.command) != (text, table.page, table.told):
            out.append(
                f"{table.page}: the table {table.name!r} is not that of {kept(table.name, top).relative_to(top)}: "
                f"measure it (--only {table.name!r}) or take it as it stands (--adopt {table.name!r})"
            )
    known = {table.name for table in tables}
    for page in sorted(top.glob("docs/**/*.md")):
        marked = (name for name, _ in MARK.findall(page.read_text(encoding="utf-8")))
        out += [
            f"{page.relative_to(top)}: {name!r} is not in docs_tables.py"
            for name in marked
            if name not in known | CHECKED_ELSEWHERE
        ]
    files = {kept(name, top) for name in known}
    out += [f"{p.relative_to(top)}: of no table" for p in sorted(top.glob("docs/figures/*.json")) if p not in files]
    return out + stale_prose(top, lambda name: record.table if (record := read_record(name, top)) else None)


def git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(TOP), *words], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def adopt(table: Table) -> None:
    """The table as it stands, with the date and commit of its youngest line."""
    if not table.page:
        sys.exit(f"{table.name}: stands on no page, so it can only be measured")
    text = on_page(table)
    if text is None:
        sys.exit(f"{table.page}: no marks for {table.name!r}")
    lines = (TOP / table.page).read_text(encoding="utf-8").split("\n")
    first = lines.index(f"<!-- {table.name}: begin -->") + 2
    rows = bare(text).count("\n") + 1
    blame = git("blame", "--line-porcelain", f"-L{first},+{rows}", "--", table.page)
    times = [
        (int(t), c[:7])
        for c, t in re.findall(r"^([0-9a-f]{40}) .*?^committer-time (\d+)$", blame, re.MULTILINE | re.DOTALL)
    ]
    when, commit = max(times, default=(0, ""))
    if not commit.strip("0"):
        when, commit = int(datetime.now(UTC).timestamp()), git("rev-parse", "--short", "HEAD")
    write(
        Record(table.name, table.page, table.told, f"{datetime.fromtimestamp(when, UTC):%Y-%m-%d}", commit, bare(text))
    )


def measure(tables: Sequence[Table], jobs: int = 1) -> None:
    """Runs the command that these tables have in common, once, and writes what it gives.

    jobs: how many runs at once, of commands that have such an option; the tables are the same.
    """
    first = tables[0]
    with tempfile.TemporaryDirectory() as folder:
        stands_for = {PYTHON: sys.executable, "{page}": str(TOP / first.page), "{out}": f"{folder}/out"}
        words = [stands_for.get(word, word) for word in first.command]
        if jobs > 1 and words[:3] == ["mapweave", "reproduce", "yuan"]:
            words += ["--jobs", str(jobs)]
        if words[0] == "mapweave":
            words = [sys.executable, "-m", *words]
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TOP / "src"), os.environ.get("PYTHONPATH", "")])}
        print(f"{', '.join(t.name for t in tables)}: {first.told}", flush=True)
        heard = subprocess.PIPE if any(t.written == "stdout" for t in tables) else None
        done = subprocess.run(words, cwd=TOP, env=env, stdout=heard, text=True, check=False)
        if done.returncode:
            sys.exit(f"{first.name}: {first.told} ended with {done.returncode}")
        for table in tables:
            keep(table, done.stdout or "", Path(folder) / "out")


def keep(table: Table, said: str, out: Path) -> None:
    """Writes the table that its command gave: `said` on stdout, or as a file in `out`."""
    if table.written == "stdout":
        text = "\n".join(line for line in said.splitlines() if line.startswith("|"))
    elif table.written == "page":
        text = bare(on_page(table) or "")
    else:
        text = (out / table.written).read_text(encoding="utf-8").strip()
    if not text:
        sys.exit(f"{table.name}: {table.told} gave no table; the old one stands")
    today = f"{datetime.now(UTC):%Y-%m-%d}"
    write(Record(table.name, table.page, table.told, today, git("rev-parse", "--short", "HEAD"), text, run=True))


def main() -> None:
    names = [table.name for table in TABLES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--only", action="append", choices=names, metavar="NAME")
    parser.add_argument("--adopt", action="append", choices=[*names, "all"], metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    chosen = [t for t in TABLES if t.name in (asked.only or asked.adopt or names) or asked.adopt == ["all"]]
    if asked.list:
        for table in TABLES:
            record = read_record(table.name)
            how = "" if record is None else "run" if record.run else "taken"
            print(f"{table.name:20s} {record.date if record else '':10s} {how:5s} {table.page}: {table.told}")
    elif asked.check:
        wrong = stale()
        print("\n".join(wrong))
        sys.exit(1 if wrong else 0)
    elif asked.adopt:
        for table in chosen:
            adopt(table)
    else:
        for command in dict.fromkeys((t.command, t.page if t.written == "page" else "") for t in chosen):
            measure([t for t in chosen if (t.command, t.page if t.written == "page" else "") == command], asked.jobs)


if __name__ == "__main__":
    main()
