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
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType

import mapweave
from mapweave.sim.laser_worlds import OfficeConfig
from mapweave.sim.swarm import SwarmScene

SOURCE = Path(mapweave.__file__).parent
PLACE = {  # column and row on the sheet; a room imports from rows below its own, or from its own row
    "cli": (6, 0),
    "api": (4, 1),
    "papers": (8, 1),
    "report": (5.9, 2),
    "viewer": (9.5, 2),
    "live": (2, 3),
    "evaluation": (10.3, 4),
    "exploration": (6.65, 4),
    "io": (2, 5),
    "sim": (6, 5),
    "team": (4.5, 6),
    "mapping": (8.6, 7),
    "fusion": (4.5, 7),
    "swarm": (2, 8),
    "landmarks": (6, 8),
    "laser": (10, 8),
    "ranges": (8, 9),
}
ESTIMATORS = ("landmarks", "laser", "ranges", "mapping", "swarm", "fusion", "team", "exploration")
EVENT_RECORDS = ("records", "landmark_log", "laser_log", "bearings")  # of core
GROWN = 1.2  # times as many calls for twice as many events: the file is entered for every event
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
    spot = {room: (float(x), -row * step, 3.2) for room, (x, row) in PLACE.items()}  # centre x and y, width
    spot |= {room: (wide / 2, -(last + 0.95 + 0.75 * k) * step, wide - 0.5) for k, room in enumerate(GROUND)}
    with figure(path, width=9.6, height=13.0) as (_, ax):
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
            says = fill(doc.replace("`", "").rstrip("."), 150 if room in GROUND else 38, max_lines=3)
            ax.text(left + 0.12, y + 0.06, says, va="top", fontsize=7, linespacing=1.15)
        ax.set_xlim(0, wide)
        ax.set_ylim(min(y for _, y, _ in spot.values()) - 0.6, 0.6)
        ax.axis("off")


@dataclass
class Entry:
    """How often functions of one file ran in a job, and whether one was given or gave what carries an event."""

    calls: int = 0
    carries: bool = False


def carries_an_event(value: object, depth: int = 2) -> bool:
    """Whether `value` is a record, a log, a state, a map or a problem made of them, or a collection that holds one.

    By where its type is defined: configurations, options, paths, names and numbers carry no event.
    """
    if isinstance(value, (tuple, list)) and type(value).__module__ == "builtins":
        return depth > 0 and bool(value) and carries_an_event(value[0], depth - 1)
    if isinstance(value, dict):
        return depth > 0 and any(carries_an_event(v, depth - 1) for v in list(value.values())[:1])
    kind = type(value)
    if not kind.__module__.startswith(f"{mapweave.__name__}.") or kind.__name__.endswith(("Config", "Options")):
        return False
    room, _, name = kind.__module__.removeprefix(f"{mapweave.__name__}.").partition(".")
    return room in (*ESTIMATORS, "solve") or (room == "core" and name in EVENT_RECORDS)


def entered(job: Callable[[], object]) -> dict[str, Entry]:
    """Files of mapweave below the command line in which a function ran while `job` did, in order of first entry."""
    root = str(SOURCE)
    seen: dict[str, Entry] = {}

    def note(frame: FrameType, event: str, result: object) -> None:
        code = frame.f_code
        function = bool(code.co_flags & inspect.CO_OPTIMIZED)  # no module or class body, which an import runs
        if event not in {"call", "return"} or not function or not code.co_filename.startswith(root):
            return
        entry = seen.setdefault(code.co_filename, Entry())
        entry.calls += event == "call"
        if not entry.carries:
            given = [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount]]
            entry.carries = any(map(carries_an_event, given if event == "call" else [result]))

    sys.setprofile(note)
    try:
        job()
    finally:
        sys.setprofile(None)
    return {str(Path(name).relative_to(root)): entry for name, entry in seen.items()}


def jobs(work: Path) -> dict[str, tuple[Callable[[], object], Callable[[], object]]]:
    """For each kind of event a small job, and the same with twice as many events."""
    for times in (1, 2):
        mapweave.simulate_landmarks(work / f"team{times}", robots=2, landmarks=8, minutes=0.5 * times, seed=1)
        mapweave.simulate_swarm(work / f"swarm{times}.csv", SwarmScene(robots=12 * times), seed=1)
    mapweave.simulate_laser(work / "office.mcap", OfficeConfig(), seed=2)

    def sightings(times: int) -> object:
        return mapweave.map(work / f"team{times}", out=work / f"a{times}")

    def scans(times: int) -> object:
        return mapweave.map(work / "office.mcap", out=work / f"b{times}", share={"1": 0.1 * times})

    def bearings(times: int) -> object:
        return mapweave.locate(work / f"swarm{times}.csv", out=work / f"c{times}")

    def steps(times: int) -> object:
        return mapweave.explore("yuan", out=work / f"d{times}", runs=1, until=5 * times)

    kinds = {"a sighting": sightings, "a scan": scans, "a bearing": bearings, "an exploration step": steps}
    return {name: (partial(job, 1), partial(job, 2)) for name, job in kinds.items()}


def stages(files: list[str], handle: set[str]) -> dict[str, list[str]]:
    """The files by folder, folders as they are first entered; those of `io` before an estimator and those after it.

    handle: the files that handle the event, of which one estimates first.
    """
    out: dict[str, list[str]] = {}
    estimated = False
    for file in files:
        folder = file.rsplit("/", maxsplit=1)[0]
        room = folder.split("/", maxsplit=1)[0]
        estimated = estimated or (room in ESTIMATORS and file in handle and not file.endswith("config.py"))
        stage = f"`{folder}/`" + ((", writing" if estimated else ", reading") if room == "io" else "")
        out.setdefault(stage, []).append(file)
    return out


def walk(name: str, once: Callable[[], object], twice: Callable[[], object]) -> str:
    """The files entered, a row a folder: those that handle the event and those that set the stage, as Markdown.

    A file handles the event when a function of it is given or gives what carries one, or runs more often for more
    events. Compiled kernels are not seen: each is called from a file of the room that its folder is named after.
    """
    once()  # imports and caches stay out of what is noted below
    few, many = entered(once), entered(twice)
    handle = {f for f, e in few.items() if e.carries or (f in many and many[f].calls > GROWN * e.calls)}
    lines = sum(len((SOURCE / f).read_text(encoding="utf-8").splitlines()) for f in few)
    lines, rest = round(lines, -2), len(few) - len(handle)
    told = f"{len(few)} files, about {lines:,} lines in all; {len(handle)} handle the event, {rest} do not"
    rows = [
        f"**What {name} enters**: {told}.\n",
        "| folder | handle the event | set the stage |",
        "| --- | --- | --- |",
    ]
    for stage, files in stages(list(few), handle).items():
        short = {f: f"`{f.rsplit('/', maxsplit=1)[1]}`" for f in files}
        way = " → ".join(short[f] for f in files if f in handle)
        others = ", ".join(short[f] for f in files if f not in handle)
        rows.append(f"| {stage} | {way} | {others} |")
    return "\n".join(rows)


def walks() -> str:
    """A table of files for each kind of event, as Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        return "\n\n".join(walk(name, *pair) for name, pair in jobs(Path(folder)).items())


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
