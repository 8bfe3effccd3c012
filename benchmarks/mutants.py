"""Would the tests notice? One-line mistakes put into the mathematics, one at a time, and the share that tests find.

    python benchmarks/mutants.py [--area TEXT] [--n 16] [--seed 0] [--least 0.95] [--folder DIR] [--page] [--list]

A mistake is a flipped sign, `-` for `+`, `/` for `*`, a lost term, a lost transpose, a constant ten times as large, a
comparison or a condition turned round, a bound left out, a `continue` or an early return left out. Settings of
configuration classes, which logs tell and not mathematics, are left as they are. Each is made in a
copy of the tree, where the quick tests of its area run, shortest file first, until one fails, and where none does the
slower ones; the tree itself is not touched. A run that takes far longer than without the mistake has found it too.
Survivors are printed as a diff: each is a test to write, unless the two lines mean the same. Those that do are named in
`mutants_areas.py` with the reason, and do not count. The same seed draws the same mistakes from the same lines.

`--quick` leaves out the slower tests. `--folder` keeps the copy, its compiled kernels and the mistakes found so far,
which are not tried again while their lines stay the same; `--page` writes the figures of the areas run into
docs/contributing.md.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from mutants_areas import AREAS, EQUIVALENT, HERE, HOUSE, ONCE_LET_PASS, Area, Equivalent, GoneError, defining
from mutants_finder import Finder, Mutant

PAGE = HERE / "docs" / "contributing.md"
TABLE = ("<!-- mutants: begin -->\n", "<!-- mutants: end -->\n")
SMALLEST_LIMIT = 20.0  # s of processor time
COMPILING = 90.0  # s more where the kernels are not those that are kept


@dataclass(frozen=True)
class Verdict:
    killed: bool
    how: str
    seconds: float


class Bench:
    """A copy of the tree, its compiled kernels, and what an area's tests take when nothing is wrong."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.kept, self.used = folder / "tree", folder / "kernels", folder / "kernels-of-mutant"
        for name in ("src", "tests"):
            shutil.rmtree(self.tree / name, ignore_errors=True)
            shutil.copytree(HERE / name, self.tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(HERE / "pyproject.toml", self.tree)
        self.kept.mkdir(exist_ok=True)
        self.report = folder / "report.xml"
        self.usual: dict[tuple[str, ...], tuple[float, list[str]]] = {}

    def judge(self, mutant: Mutant, area: Area, words: argparse.Namespace) -> Verdict:
        source = (self.tree / "src" / "mapweave" / mutant.path).read_bytes()
        seconds = 0.0
        in_kernel = mutant.path.startswith("kernels/")
        for tests, compiled in ((area.first, area.compiled or not in_kernel), (area.then, True)):
            if not tests or (words.quick and tests is area.then):
                continue
            usual, ordered = self._usual(tests, compiled=compiled)
            try:
                (self.tree / "src" / "mapweave" / mutant.path).write_bytes(mutant.apply(source))
                verdict = self._verdict(ordered, usual * words.patience, compiled=compiled, own=in_kernel)
            finally:
                (self.tree / "src" / "mapweave" / mutant.path).write_bytes(source)
            seconds += verdict.seconds
            if verdict.killed:
                return Verdict(killed=True, how=verdict.how, seconds=seconds)
        return Verdict(killed=False, how="", seconds=seconds)

    def _verdict(self, tests: list[str], limit: float, *, compiled: bool, own: bool) -> Verdict:
        """Kernels are compiled anew, aside, where the mistake is in one of them (`own`)."""
        kernels = self.kept if compiled else None
        if compiled and own:
            kernels, limit = self.used, limit + COMPILING
            shutil.rmtree(self.used, ignore_errors=True)
            shutil.copytree(self.kept, self.used, copy_function=os.link)
        code, said, seconds = self._test(tests, kernels, max(SMALLEST_LIMIT, limit))
        if code is None:
            return Verdict(killed=True, how="too slow", seconds=seconds)
        failed = [line.split(" - ")[0] for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return Verdict(killed=code != 0, how=failed[0] if failed else f"exit {code}" if code else "", seconds=seconds)

    def _usual(self, tests: tuple[str, ...], *, compiled: bool) -> tuple[float, list[str]]:
        """Seconds of processor time without a mistake, and the test files, shortest first."""
        key = (*tests, str(compiled))
        if key not in self.usual:
            for _ in range(2):  # the first run may have to compile
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                kernels = self.kept if compiled else None
                code, said, _ = self._test([*tests, f"--junitxml={self.report}"], kernels, 3600.0)
                if code:
                    raise SystemExit(f"the tests {' '.join(tests)} fail before anything is changed:\n{said}")
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                took = after.ru_utime - before.ru_utime
                taken: Counter[str] = Counter()
                for case in ET.parse(self.report).iter("testcase"):  # noqa: S314  (written by our own run)
                    file = case.get("classname", "").replace(".", "/") + ".py"
                    taken[file] += float(case.get("time", "0"))  # type: ignore[assignment]
                if took < SMALLEST_LIMIT:
                    break
            one_by_one = any("::" in test for test in tests)
            self.usual[key] = took, list(tests) if one_by_one else sorted(taken, key=lambda file: taken[file])
        return self.usual[key]

    def _test(self, tests: list[str], kernels: Path | None, limit: float) -> tuple[int | None, str, float]:
        """How the tests end (None: cut off), what they print, seconds; `kernels` None: nothing is compiled."""
        environ = os.environ | {
            "PYTHONPATH": str(self.tree / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(kernels or self.kept),
            "NUMBA_DISABLE_JIT": "0" if kernels else "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "Agg",
        }
        pytest = ["-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not slow and not data"]
        start = time.monotonic()
        process = subprocess.Popen(
            ["/bin/sh", "-c", 'ulimit -t "$0"; exec "$@"', str(int(limit)), sys.executable, *pytest, *tests],
            cwd=self.tree,
            env=environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said = process.communicate(timeout=10.0 * limit)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return None, "", time.monotonic() - start
        code = None if process.returncode in {-signal.SIGXCPU, -signal.SIGKILL} else process.returncode
        return code, said, time.monotonic() - start


class Memory:
    """Mistakes found by earlier runs, kept in a file: one that was found stays found while its line is the same."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.found: dict[str, dict] = json.loads(file.read_text()) if file.exists() else {}

    def verdict(self, mutant: Mutant) -> Verdict | None:
        known = self.found.get(name(mutant))
        return Verdict(**known) if known else None

    def note(self, mutant: Mutant, verdict: Verdict) -> None:
        if verdict.killed:
            self.found[name(mutant)] = asdict(verdict)
            self.file.write_text(json.dumps(self.found, indent=1))


@dataclass(frozen=True)
class Drawn:
    """Mistakes of one area: those to try, those known to change nothing, and how many can be made."""

    area: Area
    tried: tuple[Mutant, ...]
    equivalent: tuple[tuple[Mutant, Equivalent], ...]
    possible: int


def draw(area: Area, n: int, seed: int) -> Drawn:
    """`n` mistakes of an area (0: every one); equivalent ones among them do not count."""
    area.check_tests()
    files = {file: file.relative_to(HOUSE).as_posix() for file in area.files()}
    pool = [mutant for file, path in files.items() for mutant in possible(path, file.read_bytes())]
    same = {m: e for e in EQUIVALENT if defining(e.source) in files for m in mistakes(e)}
    drawn = sorted(sorted(pool, key=lambda mutant: lot(mutant, seed))[: n or len(pool)])
    return Drawn(
        area,
        tuple(m for m in drawn if m not in same),
        tuple((m, same[m]) for m in drawn if m in same),
        len(pool),
    )


@cache
def possible(path: str, source: bytes) -> tuple[Mutant, ...]:
    """Every mistake that can be made in a file."""
    return tuple(Finder(path, source).mutants())


@cache
def text(path: str) -> bytes:
    return (HOUSE / path).read_bytes()


@cache
def name(mutant: Mutant) -> str:
    """The line before and after, and which of equal lines it is: the same wherever the line is moved to."""
    before, after = mutant.lines(text(mutant.path))
    same = [line.strip() for line in text(mutant.path)[: mutant.start].split(b"\n")].count(before.encode())
    return f"{before}\n{after}\n{same}"


def lot(mutant: Mutant, seed: int) -> str:
    """Mistakes are drawn in the order of these: an edit elsewhere leaves the draw as it is."""
    return hashlib.sha256(f"{seed}\n{name(mutant)}".encode()).hexdigest()


def mistakes(known: Equivalent) -> list[Mutant]:
    """Those that make the line `known.before` of its file into `known.after`; there must be one."""
    file = defining(known.source)
    source = file.read_bytes()
    found = [
        mutant
        for mutant in possible(file.relative_to(HOUSE).as_posix(), source)
        if mutant.lines(source) == (known.before, known.after)
    ]
    if not found:
        raise GoneError(f"{known.source}: no mistake makes {known.before!r} into {known.after!r}")
    return found


def named() -> list[Drawn]:
    """Every mistake that tests once let pass, with the tests that are to find it."""
    out = []
    for known in ONCE_LET_PASS:
        file = defining(known.source)
        path, source = file.relative_to(HOUSE).as_posix(), file.read_bytes()
        at = source.find(known.before.encode())
        if source.count(known.before.encode()) != 1:
            raise GoneError(f"{known.source}: one line should be {known.before!r}")
        line, end = source[:at].count(b"\n") + 1, at + len(known.before.encode())
        mutant = Mutant(path, line, at, end, "named", known.before, known.after)
        out.append(Drawn(Area("once let pass", (known.source,), known.tests), (mutant,), (), 1))
    return out


def diff(mutant: Mutant) -> str:
    before, after = mutant.lines(text(mutant.path))
    return f"{mutant.path}:{mutant.line}  ({mutant.kind})\n  - {before}\n  + {after}"


def run(drawn: Drawn, bench: Bench, memory: Memory, words: argparse.Namespace) -> list[Mutant]:
    """The survivors, of those tried."""
    survivors = []
    for k, mutant in enumerate(drawn.tried):
        verdict = memory.verdict(mutant) or bench.judge(mutant, drawn.area, words)
        memory.note(mutant, verdict)
        if not verdict.killed:
            survivors.append(mutant)
        said = "killed  " if verdict.killed else "SURVIVED"
        what = f"{verdict.seconds:6.1f} s  {mutant.path}:{mutant.line}  {mutant.kind}  {verdict.how}"
        print(f"{k + 1:4}/{len(drawn.tried)} {said} {what}", flush=True)
    return survivors


HEAD = ("area", "can be made", "tried", "found", "rate", "mean the same")


def row(drawn: Drawn, survivors: int) -> tuple[str, ...]:
    tried = len(drawn.tried)
    found = tried - survivors
    rate = f"{100 * found / tried:.0f} %" if tried else "-"
    return drawn.area.name, str(drawn.possible), str(tried), str(found), rate, str(len(drawn.equivalent))


def on_page(rows: list[tuple[str, ...]], page: str) -> str:
    """The page with the rows of these areas written anew, in the order of the areas, and the others as they were."""
    before, _, rest = page.partition(TABLE[0])
    old, closed, after = rest.partition(TABLE[1])
    if not closed:
        raise GoneError(f"{PAGE.name} has no {TABLE[0].strip()} ... {TABLE[1].strip()}")
    lines = [tuple(cell.strip() for cell in line.strip("|\n").split("|")) for line in old.splitlines() if "|" in line]
    known = {cells[0]: cells for cells in lines[2:]} | {cells[0]: cells for cells in rows}
    kept = [known[area.name] for area in AREAS if area.name in known]
    tried, found = (sum(int(cells[k]) for cells in kept) for k in (2, 3))
    total = tuple(str(sum(int(cells[k]) for cells in kept)) for k in (1, 2, 3))
    same = str(sum(int(cells[5]) for cells in kept))
    kept.append(("all", *total, f"{100 * found / max(tried, 1):.0f} %", same))
    table = [HEAD, ("---", *["---:"] * (len(HEAD) - 1)), *kept]
    return before + TABLE[0] + "\n" + "".join(f"| {' | '.join(cells)} |\n" for cells in table) + "\n" + TABLE[1] + after


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--area", default="", help="areas whose name holds this text (default: all)")
    parser.add_argument("--named", action="store_true", help="only the mistakes that tests once let pass")
    parser.add_argument("--n", type=int, default=16, help="mistakes to draw in each area, 0 for every one (default 16)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default 0)")
    parser.add_argument("--patience", type=float, default=4.0, help="times the usual duration before a run is cut")
    parser.add_argument("--least", type=float, default=0.0, help="exit with 1 when a smaller share was found")
    parser.add_argument("--folder", type=Path, help="keep the copy, its kernels and what was found here")
    parser.add_argument("--quick", action="store_true", help="ask the quick tests of an area alone")
    parser.add_argument("--page", action="store_true", help="write the figures into docs/contributing.md")
    parser.add_argument("--list", action="store_true", help="print what would be drawn, and run nothing")
    words = parser.parse_args()
    chosen = [area for area in AREAS if words.area in area.name]
    if not chosen:
        parser.error(f"--area {words.area!r}: the areas are {', '.join(area.name for area in AREAS)}")
    try:
        return command(words, named() if words.named else [draw(area, words.n, words.seed) for area in chosen])
    except GoneError as error:
        parser.error(str(error))


def command(words: argparse.Namespace, drawn: list[Drawn]) -> int:
    if words.list:
        for d in drawn:
            print("\n".join(diff(mutant) for mutant in d.tried))
            print(f"{d.area.name}: {len(d.tried)} of {d.possible} mistakes\n")
        return 0
    rows, left, tried = [], 0, 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as passing:
        folder = words.folder or Path(passing)
        folder.mkdir(parents=True, exist_ok=True)
        bench, memory = Bench(folder), Memory(folder / "found.json")
        for d in drawn:
            print(f"\n{d.area.name}: {len(d.tried)} of {d.possible}")
            survivors = run(d, bench, memory, words)
            for mutant in survivors:
                print(f"SURVIVED {diff(mutant)}")
            for mutant, known in d.equivalent:
                print(f"means the same: {diff(mutant)}\n  {known.reason}")
            rows.append(row(d, len(survivors)))
            left, tried = left + len(survivors), tried + len(d.tried)
    print("\n" + "\n".join(f"{cells[0]:26}" + "".join(f"{cell:>15}" for cell in cells[1:]) for cells in (HEAD, *rows)))
    if words.page and not words.named:
        PAGE.write_text(on_page(rows, PAGE.read_text()))
    return int(1 - left / max(tried, 1) < words.least)


if __name__ == "__main__":
    sys.exit(main())
