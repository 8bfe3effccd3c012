"""Recipes: every example as a page of the documentation, with what it prints and the picture of its result.

`python benchmarks/recipes.py [--only NAME]` runs the examples and writes `docs/recipes/`. That a page holds the code of
its script is checked by `benchmarks/lint.py`, that it prints what the page says by `tests/test_examples.py`. Each runs
with an empty cache of compiled code, again, so that its page tells both times, and once more to draw.
"""

import argparse
import os
import re
import resource
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path

from gallery import lighten

from mapweave import __version__

TOP = Path(__file__).resolve().parent.parent
PAGES = TOP / "docs" / "recipes"
DRAW = """
import sys
from mapweave.report.result import ResultBase
results = [value for value in made.values() if isinstance(value, ResultBase)]
if results:
    results[-1].plot().savefig(sys.argv[2], dpi=90, bbox_inches="tight")
"""
RUN = "import runpy, sys; made = runpy.run_path(sys.argv[1], run_name='__main__')"
PRINTED = "It prints\n\n```\n"

MADE = runpy.run_path(str(TOP / "examples" / "make_notebooks.py"))
cells, scripts = MADE["cells"], MADE["scripts"]


def title(script: Path) -> str:
    """What the example is about: its first words."""
    return re.split(r"[:;,.]", told(script))[0]


def told(script: Path) -> str:
    return script.read_text(encoding="utf-8").split('"""', 2)[1].strip()


def body(script: Path) -> str:
    """The page down to what the script prints: the same for the same script."""
    out = [f"# {title(script)}", told(script), f"{{download}}`As a notebook <notebooks/{script.stem}.ipynb>`"]
    for kind, group in groupby(cells(script.read_text(encoding="utf-8"))[1:], lambda cell: cell["cell_type"]):
        text = "\n\n".join(cell["source"] for cell in group)
        out.append(text if kind == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join([*out, ""])


def page_of(script: Path) -> Path:
    return PAGES / f"{script.stem.replace('_', '-')}.md"


def printed(page: str) -> list[str]:
    """The lines that a page says its script prints."""
    return page.split(PRINTED, 1)[1].split("```", 1)[0].splitlines()


def index() -> str:
    """The page that lists all others."""
    out = ["# Recipes", "", "One job a page: a short script, what it prints and what it draws. The scripts are in the"]
    out += [
        "folder `examples`; `python examples/make_notebooks.py` makes notebooks of them, which the pages link to.",
        "",
    ]
    out += [f"- [{title(script)}]({page_of(script).name})" for script in scripts()]
    return "\n".join([*out, "", "```{toctree}", ":hidden:", "", *(page_of(s).stem for s in scripts()), "```", ""])


def stale() -> Iterator[str]:
    """Pages that are not those of their scripts."""
    for script in scripts():
        page = page_of(script)
        if not page.exists() or not page.read_text(encoding="utf-8").startswith(body(script)):
            yield f"docs/recipes/{page.name}: not of examples/{script.name}: python benchmarks/recipes.py"
    if not (PAGES / "index.md").exists() or (PAGES / "index.md").read_text(encoding="utf-8") != index():
        yield "docs/recipes/index.md: not of the examples: python benchmarks/recipes.py"


def run(script: Path, home: Path, more: str = "") -> tuple[str, float]:
    """What the script says, and the processor time [s] it takes, all its processes together."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-c", RUN + more, str(script), str(home / "picture.png")]
    environment = {**os.environ, "MAPWEAVE_CACHE_DIR": str(home / "cache")}
    said = subprocess.run(words, cwd=home, env=environment, check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return said, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def write(script: Path) -> None:
    """Runs the script, with nothing compiled and again, and writes its page and its picture."""
    picture = PAGES / "images" / f"{page_of(script).stem}.png"
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        said, first = run(script, home)
        _, later = run(script, home)
        run(script, home, DRAW)
        if (home / "picture.png").exists():
            lighten(home / "picture.png", picture)
    out = [f"{body(script)}{PRINTED}{said}```", ""]
    if picture.exists():
        out += [f"![{title(script)}](images/{picture.name})", ""]
    out += [f"| `examples/{script.name}` | processor time [s] |", "| --- | ---: |"]
    out += [f"| first run, which compiles | {first:.0f} |", f"| later runs | {later:.0f} |", ""]
    out += [f"Run {datetime.now(UTC):%Y-%m-%d} with `mapweave {__version__}` by `python benchmarks/recipes.py`.", ""]
    page_of(script).write_text("\n".join(out), encoding="utf-8")


def main() -> None:
    known = {script.stem: script for script in scripts()}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=sorted(known), metavar="NAME")
    asked = parser.parse_args()
    PAGES.mkdir(exist_ok=True)
    (PAGES / "index.md").write_text(index(), encoding="utf-8")
    for name in asked.only or known:
        write(known[name])
        print(page_of(known[name]).relative_to(TOP))


if __name__ == "__main__":
    main()
