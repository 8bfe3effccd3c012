"""What the house says of itself: names, numbers and pages. `python benchmarks/lint.py` tells each offence in a line.

None of it changes what a user is given, so that no test fails for it: sources and pages are read, not run.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import docs_figures
import docs_prose
import gallery
import recipes
from docs_tables import TABLES

TOP = Path(__file__).resolve().parent.parent
HOUSE = TOP / "src" / "mapweave"
FACES = {"io", "papers", "report", "viewer", "cli", "live", "sim"}  # whole numbers there are formats, counts and codes
COMPUTING = ("landmarks", "fusion", "laser", "mapping", "swarm", "team", "exploration", "kernels", "solve")
SCALE = 1e-3, 1e3  # what lies outside is so small or so large that it stands for nothing or for everything
DEFAULTS = {  # floats that an argument has by itself in those rooms, and why
    "swarm/start.py: relative_odometry_frame(limit)": "callers in the package name their own",
    "swarm/filtered.py: filter_start(sigma)": "the paper's",
}
LITERALS = (ast.Constant, ast.Tuple, ast.List, ast.Dict, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.Load)
EQUATION = re.compile(r"\[(Kojima12|Hamatani|Hara07|Yuan09)\]\s+eqs?\.\s*([0-9]+)(?:-([0-9]+))?")
MARK = re.compile(r"pytest\.mark\.eq\(([^)]*)\)", re.DOTALL)
NAMED = re.compile(r"`((?:[a-z_]+/)+(?:[a-z_0-9]+\.py)?)`")
TEST = re.compile(r"`(tests/[\w/]+\.py)(?:::(\w+))?`")
WALKED = re.compile(r"^\| `((?:[a-z]+/)+)`[^|]*\| ([^|]*)\| ([^|]*)\|$", re.MULTILINE)
CALLED = re.compile(r"`(?:\w+\.)*([a-z][a-z0-9]*(?:_[a-z0-9]+)+)(?:\([^`]*\))?`")
OTHERS = {"local_k", "small_gicp"}  # a frame, a library to compare with
FOLDERS_OF_RESULTS = {"trajectories/", "state/", "figures/", "log/", "recording/", "result/", "local/", "components/"}


def classes_of_one_name(sources: dict[str, str]) -> Iterator[str]:
    """One name, one meaning: classes at the top of modules (`sources`: module -> its text) that share a public name."""
    homes = defaultdict(list)
    for module, text in sources.items():
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(module)
    return (f"{name}: the name of a class in each of {', '.join(m)}" for name, m in homes.items() if len(m) > 1)


def is_number(value: ast.expr, *, whole: bool) -> bool:
    """Whether an expression is a number, or numbers put together, with nothing called or named; `whole`: ints too."""
    parts, kinds = list(ast.walk(value)), {int, float} if whole else {float}
    numbers = [p.value for p in parts if isinstance(p, ast.Constant) and type(p.value) in kinds]
    return bool(numbers) and all(isinstance(p, LITERALS) for p in parts)


def unexplained(source: str, *, whole: bool = True) -> list[str]:
    """Names given numbers at the top level of `source` without a comment on their lines or on the line above."""
    lines, found = source.splitlines(), []
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        own = lines[node.lineno - 1 : node.end_lineno]
        above = lines[node.lineno - 2].strip() if node.lineno > 1 else ""
        said = any("# " in line for line in own) or above.startswith("#")
        if is_number(node.value, whole=whole) and not said:
            found.append(ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target))
    return found


def float_defaults(source: str) -> list[str]:
    """`function(argument)` of each that is given a float of a `SCALE` that can decide anything, 1 excepted."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            plain = [*node.args.posonlyargs, *node.args.args]
            given = [*zip(plain[::-1], node.args.defaults[::-1], strict=False)]
            for arg, default in [*given, *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)]:
                value = default.value if isinstance(default, ast.Constant) else None
                if type(value) is float and SCALE[0] < abs(value) < SCALE[1] and value != 1.0:
                    found.append(f"{node.name}({arg.arg})")
    return found


def sources() -> dict[str, str]:
    return {p.relative_to(HOUSE).as_posix(): p.read_text(encoding="utf-8") for p in sorted(HOUSE.rglob("*.py"))}


def pages() -> list[Path]:
    return sorted([*TOP.glob("docs/**/*.md"), TOP / "README.md"])


def numbers() -> Iterator[str]:
    """Thresholds stand in the configuration, and what stays at the top of a module says what it is."""
    defaults = set()
    for place, text in sources().items():
        room = place.split("/")[0]
        for name in unexplained(text, whole=room not in FACES):
            yield f"{place}: {name}: a number without a comment that says what it is"
        defaults |= {f"{place}: {name}" for name in float_defaults(text)} if room in COMPUTING else set()
    for name in sorted(defaults ^ set(DEFAULTS)):
        gone = name in DEFAULTS
        yield f"{name}: " + ("is no longer so; take it from DEFAULTS" if gone else "a threshold as a default")


def equations(computed: dict[str, str], tests: list[str]) -> Iterator[str]:
    """Each equation named where it is computed (`computed`: file -> text) is named by a test that checks it."""
    checked = {t for text in tests for tags in MARK.findall(text) for t in re.findall(r"\"([A-Za-z0-9]+:\d+)\"", tags)}
    for place, text in computed.items():
        for paper, first, last in EQUATION.findall(text):
            for number in range(int(first), int(last or first) + 1):
                if f"{paper}:{number}" not in checked:
                    yield f"{place}: equation {paper}:{number} is named by no test"


@cache
def names() -> frozenset[str]:
    """What the code calls something: modules, functions, classes, arguments, attributes, and whole strings."""
    found = {Path(place).stem for place in sources()}
    for text in sources().values():
        for node in ast.walk(ast.parse(text)):
            for field in ("name", "arg", "attr", "id", "value"):
                value = getattr(node, field, None)
                if isinstance(value, str):
                    found.add(value)
    return frozenset(found)


def named_on(page: Path) -> Iterator[str]:
    """Files, tests, and on a page of methods functions and settings, that a page names and that are not there."""
    text, where = page.read_text(encoding="utf-8"), page.relative_to(TOP)
    for name in NAMED.findall(text):
        of_results = name.split("/")[0] + "/" in FOLDERS_OF_RESULTS
        if not ((HOUSE / name).exists() or (TOP / name).exists() or of_results):
            yield f"{where}: no such file: {name}"
    for file, name in TEST.findall(text):
        path = TOP / file
        if not path.exists() or (name and f"def {name}(" not in path.read_text(encoding="utf-8")):
            yield f"{where}: no such test: {file}::{name}"
    if page.parent.name == "methods":
        for name in CALLED.findall(text):
            if name not in names() | OTHERS:
                yield f"{where}: {name}: in no source"


def walked() -> Iterator[str]:
    """Files that an event is said to enter and that are not in the folder that is told."""
    for folder, *cells in WALKED.findall((TOP / "docs" / "architecture.md").read_text(encoding="utf-8")):
        for name in re.findall(r"`([^`]+)`", " ".join(cells)):
            if not (HOUSE / (folder + name)).is_file():
                yield f"docs/architecture.md: no such file: {folder}{name}"


def pictures() -> Iterator[str]:
    """The gallery shows pictures that are there, light, under the commands that make them."""
    files = sorted(gallery.PICTURES.iterdir())
    if gallery.PAGE.read_text(encoding="utf-8") != gallery.page():
        yield f"{gallery.PAGE}: not the page that benchmarks/gallery.py makes"
    if files != sorted(p.image for p in gallery.GALLERY):
        yield f"{gallery.PICTURES}: not the pictures that benchmarks/gallery.py names"
    if sum(f.stat().st_size for f in files) >= 1_500_000:
        yield f"{gallery.PICTURES}: more than 1.5 MB"


def tables() -> Iterator[str]:
    """Measured tables are those that were measured, by scripts that are there, and sentences follow them."""
    yield from docs_figures.stale()
    yield from docs_prose.unlisted(TOP)
    for table in TABLES:
        for word in table.command:
            if word.startswith("benchmarks/") and not (TOP / word).exists():
                yield f"{table.name}: no such script: {word}"
    if len({docs_figures.kept(t.name) for t in TABLES}) < len(TABLES):
        yield "docs_tables.py: two tables are kept in one file"


def offences() -> Iterator[str]:
    """Everything that is said and is not so."""
    yield from classes_of_one_name(sources())
    yield from numbers()
    yield from equations(sources(), [p.read_text(encoding="utf-8") for p in (TOP / "tests").rglob("test_*.py")])
    for page in pages():
        yield from named_on(page)
    yield from walked()
    yield from pictures()
    yield from recipes.stale()
    yield from tables()


def main() -> None:
    found = list(offences())
    print("\n".join(found) or "what the house says of itself is so")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
