"""The house as the code has it: rooms, imports, and every file one event enters between the reader and the page.

`python benchmarks/house.py [--picture docs/images/house.png] [--walks docs/architecture.md]`

The picture and the walks are measured: imports are read from the source, and a walk runs a small simulated job while it
notes each file of mapweave in which a function runs. `--walks` writes them between the two marks of that page.
"""

import argparse
import ast
import inspect
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import mapweave
from mapweave.sim.office import OfficeConfig
from mapweave.sim.swarm import SwarmScene

SOURCE = Path(mapweave.__file__).parent
PLACE = {  # column and row on the sheet; a room imports from rows below its own, or from its own row
    "cli": (6, 0),
    "api": (6, 1),
    "papers": (2, 2),
    "report": (6, 2),
    "viewer": (10, 2),
    "exploration": (4, 3),
    "evaluation": (8, 3),
    "io": (2, 4),
    "sim": (6, 4),
    "team": (10, 4),
    "fusion": (4, 5),
    "laser": (2, 6),
    "landmarks": (6, 6),
    "swarm": (10, 6),
}
ESTIMATORS = ("landmarks", "laser", "swarm", "fusion", "team", "exploration")
GROUND = ("solve", "core", "kernels")  # every room stands on these
INK = "#5F6B76"
BEGIN, END = "<!-- walks: begin -->", "<!-- walks: end -->"


def rooms() -> dict[str, tuple[int, int, str]]:
    """Files, lines and first sentence of every room."""
    out = {}
    for room in (*PLACE, *GROUND):
        files = sorted((SOURCE / room).rglob("*.py"))
        doc = ast.get_docstring(ast.parse((SOURCE / room / "__init__.py").read_text(encoding="utf-8"))) or ""
        lines = sum(len(f.read_text(encoding="utf-8").splitlines()) for f in files)
        out[room] = (len(files), lines, doc.split("\n", maxsplit=1)[0])
    return out


def imports() -> Counter[tuple[str, str]]:
    """How often a file of one room imports from another room."""
    out: Counter[tuple[str, str]] = Counter()
    for path in SOURCE.rglob("*.py"):
        here = path.relative_to(SOURCE).parts
        if len(here) < 2:  # the package's own face
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == len(here):
                names = [node.module.split(".")[0]] if node.module else [a.name for a in node.names]
                for name in names:
                    if name != here[0] and (SOURCE / name).is_dir():
                        out[here[0], name] += 1
    return out


def needed(arrows: Counter[tuple[str, str]]) -> list[tuple[str, str]]:
    """The arrows no longer way through other rooms stands for, those to the ground left out."""
    above = {pair for pair in arrows if pair[1] not in GROUND}
    reach = set(above)
    grown = True
    while grown:
        more = {(a, d) for a, b in reach for c, d in above if b == c} - reach
        reach |= more
        grown = bool(more)
    return sorted((a, b) for a, b in above if not any((a, c) in reach and (c, b) in reach for c, _ in above))


def draw(path: Path) -> None:
    """Rooms as boxes with what they are for, and the imports that no way through other rooms stands for."""
    from textwrap import fill

    from matplotlib.patches import FancyBboxPatch

    from mapweave.report.style import PALETTE, figure

    size = rooms()
    high, step, wide = 0.86, 1.32, 12.0
    last = max(row for _, row in PLACE.values())
    spot = {room: (float(x), -row * step, 3.5) for room, (x, row) in PLACE.items()}  # centre x and y, width
    spot |= {room: (wide / 2, -(last + 0.95 + 0.75 * k) * step, wide - 0.5) for k, room in enumerate(GROUND)}
    with figure(path, width=9.6, height=10.2) as (_, ax):
        for a, b in needed(imports()):
            (xa, ya, wide_a), (xb, yb, wide_b) = spot[a], spot[b]
            side = 1 if xb > xa else -1
            start = (xa + side * wide_a / 2, ya) if ya == yb else (xa + 0.1 * (xb - xa), ya - high / 2)
            end = (xb - side * wide_b / 2, yb) if ya == yb else (xb - 0.1 * (xb - xa), yb + high / 2)
            line = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.1, "shrinkA": 1, "shrinkB": 1}
            ax.annotate("", end, start, arrowprops=line, zorder=1)
        for room, (x, y, width) in spot.items():
            _, lines, doc = size[room]
            edge = PALETTE[4] if room in GROUND else PALETTE[0] if room in ESTIMATORS else "#8A949E"
            left, right = x - width / 2, x + width / 2
            box = FancyBboxPatch(
                (left, y - high / 2), width, high, "round,pad=0,rounding_size=0.1", fc="white", ec=edge, lw=1.8
            )
            ax.add_patch(box)
            ax.text(left + 0.12, y + 0.25, room, va="center", fontsize=10, fontweight="bold")
            ax.text(
                right - 0.12, y + 0.25, f"{lines / 1000:.1f}k lines", ha="right", va="center", fontsize=7, color=INK
            )
            says = fill(doc.replace("`", "").rstrip("."), 150 if room in GROUND else 42, max_lines=3)
            ax.text(left + 0.12, y + 0.06, says, va="top", fontsize=7, linespacing=1.15)
        ax.set_xlim(0, wide)
        ax.set_ylim(min(y for _, y, _ in spot.values()) - 0.6, 0.6)
        ax.axis("off")


def entered(job: Callable[[], object]) -> list[str]:
    """Files of mapweave below the command line in which a function ran while `job` did, in order of first entry."""
    root = str(SOURCE)
    seen: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        function = bool(code.co_flags & inspect.CO_OPTIMIZED)  # no module or class body, which an import runs
        if event == "call" and function and code.co_filename.startswith(root):
            seen.setdefault(code.co_filename, None)

    sys.setprofile(note)
    try:
        job()
    finally:
        sys.setprofile(None)
    return [str(Path(name).relative_to(root)) for name in seen]


def jobs(work: Path) -> dict[str, Callable[[], object]]:
    """One small job for each kind of event; every one is run once before, so that imports and caches stay out."""
    mapweave.simulate_landmarks(work / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.simulate_laser(work / "office.mcap", OfficeConfig(), seed=2)
    mapweave.simulate_swarm(work / "swarm.csv", SwarmScene(robots=12), seed=1)
    return {
        "a sighting": lambda: mapweave.map(work / "team", out=work / "a"),
        "a scan": lambda: mapweave.map(work / "office.mcap", out=work / "b", share={"1": 0.1}),
        "a bearing": lambda: mapweave.locate(work / "swarm.csv", out=work / "c"),
        "an exploration step": lambda: mapweave.explore("yuan", out=work / "d", runs=1, until=5),
    }


def walks() -> str:
    """A list of files for each kind of event, as Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        out = []
        for name, job in jobs(Path(folder)).items():
            job()
            files = entered(job)
            way = " → ".join(f"`{f}`" for f in files)
            out.append(f"**What {name} enters**, {len(files)} files: {way}.")
    return "\n\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--walks", type=Path, nargs="?", const=Path(), default=None)
    asked = parser.parse_args()
    for room, (files, lines, doc) in rooms().items():
        print(f"{room:12} {files:3} files {lines:6} lines  {doc}")
    if asked.picture:
        draw(asked.picture)
    if asked.walks is not None:
        text = walks()
        print(text)
        if asked.walks.is_file():
            page = asked.walks.read_text(encoding="utf-8")
            marked = re.compile(re.escape(BEGIN) + ".*?" + re.escape(END), re.DOTALL)
            if not marked.search(page):
                sys.exit(f"{asked.walks}: no marks {BEGIN} and {END}")
            asked.walks.write_text(marked.sub(f"{BEGIN}\n{text}\n{END}", page), encoding="utf-8")


if __name__ == "__main__":
    main()
