"""Would the tests notice? One-line mistakes put into the mathematics, one at a time, and the share that tests find.

    python benchmarks/mutants.py [--seed 0] [--n 100] [--only 'fusion/*'] [--jobs 1] [--least 0.95] [--list]

A mistake is a flipped sign, `-` for `+`, `/` for `*`, a lost term, a lost transpose, a constant ten times as large, a
comparison or a condition turned round, a bound left out, a `continue` or an early return left out. Each is made in a
copy of the tree, where the tests of its area run until the first fails; the tree itself is not touched. A run that
takes far longer than without the mistake has found it too. Survivors are printed as a diff: each is a test to write,
unless the two lines mean the same. The same seed draws the same mistakes from the same sources.
"""

import argparse
import ast
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from queue import SimpleQueue

HERE = Path(__file__).resolve().parent.parent
HOUSE = Path("src/mapweave")


@dataclass(frozen=True)
class Area:
    """Sources (patterns under src/mapweave) and the tests that must notice, those that tell soonest first."""

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]


AREAS = (
    Area(
        "poses and Gaussians",
        ("core/se2.py", "core/gaussian.py"),
        ("tests/core", "tests/solve", "tests/fusion"),
    ),
    Area("solver", ("solve/*.py",), ("tests/solve",)),
    Area(
        "landmark filter",
        ("kernels/landmarks/ekf*.py",),
        (
            "tests/kernels/test_ekf.py",
            "tests/kernels/test_ekf_drive_noise.py",
            "tests/kernels/test_ekf_smooth.py",
            "tests/landmarks",
        ),
    ),
    Area(
        "association",
        ("landmarks/association.py",),
        ("tests/landmarks/test_association.py", "tests/landmarks/test_pairing.py", "tests/landmarks", "tests/fusion"),
    ),
    Area(
        "fusion",
        (
            "fusion/alignment.py",
            "fusion/identities.py",
            "fusion/full_covariance.py",
            "fusion/relative*.py",
            "fusion/handover.py",
        ),
        ("tests/fusion", "tests/papers/test_relative_theorems.py"),
    ),
    Area(
        "swarm",
        ("swarm/bearing.py", "swarm/factors.py", "swarm/linear.py", "swarm/network.py"),
        ("tests/swarm/test_bearing_model.py", "tests/swarm/test_contradiction.py", "tests/swarm"),
    ),
    Area(
        "laser matching",
        (
            "kernels/laser/icp.py",
            "kernels/laser/likelihood_field.py",
            "kernels/laser/local_map.py",
            "kernels/laser/refine.py",
            "kernels/laser/resample.py",
            "laser/scan_matching.py",
        ),
        (
            "tests/kernels/test_resample.py",
            "tests/kernels/test_field.py",
            "tests/laser/test_scan_matching.py",
            "tests/laser/test_match_information.py",
            "tests/laser/test_icp.py",
            "tests/laser/test_particle_ancestry.py",
            "tests/kernels/test_tiles.py",
            "tests/laser",
        ),
    ),
    Area("laser graph", ("laser/closures.py", "laser/graph_problem.py"), ("tests/laser",)),
    Area(
        "walls",
        ("kernels/walls/raycast.py", "kernels/walls/wall_grid.py"),
        ("tests/kernels/test_raycast.py", "tests/kernels/test_wall_grid.py", "tests/core/test_walls.py"),
    ),
)


@dataclass(frozen=True, order=True)
class Mutant:
    """`old` at bytes `start` to `end` of a source becomes `new`, on one line."""

    path: str
    line: int
    start: int
    end: int
    kind: str
    old: str
    new: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.start] + self.new.encode() + source[self.end :]


ARITHMETIC = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
COMPARISONS = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
BOUNDS = {"min", "max", "minimum", "maximum"}
SKIPPED_FIELDS = {"annotation", "returns", "decorator_list"}
SKIPPED_NODES = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)
SKIPPED_KEYWORDS = {"axis", "dtype", "stacklevel"}


class Finder:
    """Every mistake that can be made in one source."""

    def __init__(self, path: str, source: bytes) -> None:
        self.path, self.source, self.tree = path, source, ast.parse(source)
        self.meaning = ast.dump(self.tree)
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def mutants(self) -> list[Mutant]:
        found = set(self._of(self.tree, in_index=False))
        return sorted(m for m in found if m.old != m.new and self._parses(m))

    def _of(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        if isinstance(node, SKIPPED_NODES) or (isinstance(node, ast.keyword) and node.arg in SKIPPED_KEYWORDS):
            return
        if getattr(node, "lineno", 0) == getattr(node, "end_lineno", None):
            yield from self._of_operator(node, in_index=in_index)
            yield from self._of_value(node, in_index=in_index)
        for field, value in ast.iter_fields(node):
            if field in SKIPPED_FIELDS:
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from self._of(
                        child, in_index=in_index or (isinstance(node, ast.Subscript) and field == "slice")
                    )
        if isinstance(node, ast.FunctionDef | ast.For | ast.While):
            yield from self._exits(node)

    def _of_operator(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        match node:
            case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
                yield from self._between(left, right, *ARITHMETIC[type(op)], "arithmetic")
                if isinstance(op, ast.Add | ast.Sub) and not in_index:
                    yield self._whole(node, self._text(left), "lost term")
                    minus = "-" if isinstance(op, ast.Sub) else ""
                    yield self._whole(node, f"{minus}({self._text(right)})", "lost term")
            case ast.UnaryOp(op=ast.USub(), operand=operand) if not in_index:
                yield self._whole(node, f"({self._text(operand)})", "sign")
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield self._whole(node, f"({self._text(operand)})", "condition")
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
                yield from self._between(left, right, *COMPARISONS[type(op)], "comparison")
            case ast.BoolOp(op=op, values=[left, right, *_]):
                words = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
                yield from self._between(left, right, *words, "condition")
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in ARITHMETIC:
                yield from self._between(target, value, *ARITHMETIC[type(op)], "arithmetic")

    def _of_value(self, node: ast.AST, *, in_index: bool) -> Iterator[Mutant]:
        match node:
            case ast.Attribute(value=value, attr="T"):
                yield self._whole(node, self._text(value), "lost transpose")
            case ast.Call(func=ast.Attribute(attr="clip"), args=[value, _, _]):
                yield self._whole(node, f"({self._text(value)})", "lost bound")
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[first, second]) if name in BOUNDS:
                kept = second if isinstance(first, ast.Constant) else first
                yield self._whole(node, f"({self._text(kept)})", "lost bound")
            case ast.Constant(value=float() as value) if value not in {0.0, float("inf")} and not in_index:
                yield self._whole(node, repr(10.0 * value), "constant")

    def _exits(self, node: ast.FunctionDef | ast.For | ast.While) -> Iterator[Mutant]:
        """`if ...: continue` and `if ...: return`, where more follows in the same block."""
        for inner in node.body[:-1]:
            if isinstance(inner, ast.If) and isinstance(inner.body[-1], ast.Continue | ast.Return):
                last = inner.body[-1]
                if last.lineno == last.end_lineno:
                    yield self._whole(last, "pass", "lost exit")

    def _between(self, left: ast.expr, right: ast.expr, old: str, new: str, kind: str) -> Iterator[Mutant]:
        low, high = self._span(left)[1], self._span(right)[0]
        at = self.source[low:high].find(old.encode())
        if at >= 0 and b"\n" not in self.source[low:high]:
            yield self._mutant(left.end_lineno or 0, low + at, low + at + len(old), new, kind)

    def _whole(self, node: ast.expr | ast.stmt, new: str, kind: str) -> Mutant:
        return self._mutant(node.lineno, *self._span(node), new, kind)

    def _mutant(self, line: int, start: int, end: int, new: str, kind: str) -> Mutant:
        return Mutant(self.path, line, start, end, kind, self.source[start:end].decode(), new)

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        low = self.starts[node.lineno - 1] + node.col_offset
        return low, self.starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)

    def _text(self, node: ast.expr) -> str:
        low, high = self._span(node)
        return self.source[low:high].decode()

    def _parses(self, mutant: Mutant) -> bool:
        try:
            return ast.dump(ast.parse(mutant.apply(self.source))) != self.meaning
        except SyntaxError:
            return False


@dataclass(frozen=True)
class Verdict:
    killed: bool
    how: str
    seconds: float


class Bench:
    """A copy of the tree, its compiled kernels, and how long an area's tests take when nothing is wrong."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.kept, self.used = folder / "tree", folder / "kernels", folder / "kernels-of-mutant"
        for name in ("src", "tests"):
            shutil.copytree(HERE / name, self.tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(HERE / "pyproject.toml", self.tree)
        self.usual: dict[str, float] = {}

    def judge(self, mutant: Mutant, area: Area, patience: float) -> Verdict:
        if area.name not in self.usual:
            code, said, seconds = self._test(area, self.kept, 3600.0)
            if code:
                raise SystemExit(f"the tests of {area.name!r} fail before anything is changed:\n{said}")
            self.usual[area.name] = seconds
        file = self.tree / HOUSE / mutant.path
        source = file.read_bytes()
        shutil.rmtree(self.used, ignore_errors=True)
        shutil.copytree(self.kept, self.used)
        try:
            file.write_bytes(mutant.apply(source))
            code, said, seconds = self._test(area, self.used, 60.0 + patience * self.usual[area.name])
        finally:
            file.write_bytes(source)
        if code is None:
            return Verdict(killed=True, how="too slow", seconds=seconds)
        failed = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return Verdict(killed=code != 0, how=failed[0].split(" - ")[0] if failed else "", seconds=seconds)

    def _test(self, area: Area, kernels: Path, limit: float) -> tuple[int | None, str, float]:
        kernels.mkdir(exist_ok=True)
        environ = os.environ | {
            "PYTHONPATH": str(self.tree / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(kernels),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "Agg",
        }
        words = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:randomly", "-m", "not slow and not data"]
        start = time.monotonic()
        tests = subprocess.Popen(
            [sys.executable, "-m", "pytest", *words, *area.tests],
            cwd=self.tree,
            env=environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said = tests.communicate(timeout=limit)[0]
        except subprocess.TimeoutExpired:
            os.killpg(tests.pid, signal.SIGKILL)
            tests.communicate()
            return None, "", time.monotonic() - start
        return tests.returncode, said, time.monotonic() - start


def all_mutants(only: str) -> list[tuple[Mutant, Area]]:
    """Every mistake that can be made in the sources that `only` names, in the order of areas, files and lines."""
    out = []
    for area in AREAS:
        files = sorted({f for pattern in area.sources for f in (HERE / HOUSE).glob(pattern)})
        for file in files:
            path = file.relative_to(HERE / HOUSE).as_posix()
            if fnmatch(path, only):
                out += [(mutant, area) for mutant in Finder(path, file.read_bytes()).mutants()]
    return out


def diff(mutant: Mutant) -> str:
    source = (HERE / HOUSE / mutant.path).read_bytes()
    old, new = (text.splitlines()[mutant.line - 1].decode().strip() for text in (source, mutant.apply(source)))
    return f"{mutant.path}:{mutant.line}  ({mutant.kind})\n  - {old}\n  + {new}"


def run_all(drawn: list[tuple[Mutant, Area]], jobs: int, patience: float) -> dict[Mutant, Verdict]:
    verdicts: dict[Mutant, Verdict] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        benches: SimpleQueue[Bench] = SimpleQueue()
        for k in range(jobs):
            benches.put(Bench(Path(folder) / str(k)))

        def judge(mutant: Mutant, area: Area) -> Verdict:
            bench = benches.get()
            try:
                return bench.judge(mutant, area, patience)
            finally:
                benches.put(bench)

        waiting = {pool.submit(judge, *pair): pair[0] for pair in drawn}
        for done in as_completed(waiting):
            mutant, verdict = waiting[done], done.result()
            verdicts[mutant] = verdict
            said = "killed  " if verdict.killed else "SURVIVED"
            what = f"{verdict.seconds:6.1f} s  {mutant.path}:{mutant.line}  {mutant.kind}  {verdict.how}"
            print(f"{len(verdicts):4}/{len(drawn)} {said} {what}", flush=True)
    return verdicts


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default 0)")
    parser.add_argument("--n", type=int, default=100, help="mistakes to draw, 0 for every one (default 100)")
    parser.add_argument("--only", default="*", help="sources under src/mapweave to draw from, such as 'solve/*'")
    parser.add_argument("--jobs", type=int, default=1, help="copies of the tree that work side by side (default 1)")
    parser.add_argument("--patience", type=float, default=4.0, help="times the usual duration before a run is cut")
    parser.add_argument("--least", type=float, default=0.0, help="exit with 1 when a smaller share was found")
    parser.add_argument("--list", action="store_true", help="print what would be drawn, and run nothing")
    words = parser.parse_args()
    pool = all_mutants(words.only)
    if not pool:
        parser.error(f"--only {words.only!r} names no source of any area")
    drawn = pool
    if words.n:
        rng = random.Random(words.seed)  # noqa: S311  (a draw, not a secret)
        drawn = [pool[k] for k in sorted(rng.sample(range(len(pool)), min(words.n, len(pool))))]
    if words.list:
        print("\n".join(diff(mutant) for mutant, _ in drawn), f"\n{len(drawn)} of {len(pool)} mistakes")
        return 0
    verdicts = run_all(drawn, words.jobs, words.patience)
    survivors = [m for m, _ in drawn if not verdicts[m].killed]
    if survivors:
        print("\nSurvivors\n" + "\n".join(diff(m) for m in survivors))
    total, killed = Counter(area.name for _, area in drawn), Counter(a.name for m, a in drawn if verdicts[m].killed)
    print(f"\n{'area':22}{'killed':>8}{'drawn':>8}{'rate':>8}")
    for name, count in total.items():
        print(f"{name:22}{killed[name]:8}{count:8}{killed[name] / count:8.0%}")
    rate = 1 - len(survivors) / len(drawn)
    print(f"{'all':22}{killed.total():8}{len(drawn):8}{rate:8.0%}")
    return int(rate < words.least)


if __name__ == "__main__":
    sys.exit(main())
