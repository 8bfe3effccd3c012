"""What the rooms of the house may know of each other, and of the world: `python benchmarks/contract.py` tells offences.

Sources are read, not run, wherever an import stands: in a function, under `TYPE_CHECKING`, as text that
`import_module` is given. The order of the rooms is that of the contract in `pyproject.toml`.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
ESTIMATORS = ("solve", "landmarks", "laser", "swarm", "ranges", "fusion", "mapping", "team")
HOMES = {  # a library, and where alone it may be imported
    "numba": ("kernels._jit",),
    "zenoh": ("live.transport",),
    "matplotlib": ("report.style",),
    "rerun": ("viewer",),
}
FILES = {  # calls that open a file
    *("open", "read_text", "read_bytes", "write_text", "write_bytes"),
    *("load", "loadtxt", "genfromtxt", "savez", "save"),
}
OWNERS = {"np", "Path", "io", "os"}  # of the names above, where they are no method of a path
CLOCKS = {"time", "perf_counter", "monotonic", "process_time", "now", "utcnow", "time_ns", "perf_counter_ns"}
TIMED = {"laser.localise", "mapping.laser_mapping"}  # tell how long they took, and decide nothing by it
DOTTED = re.compile(r"mapweave\.([a-z_]+)((?:\.[a-z_0-9]+)*)(?::\w+)?")


@dataclass(frozen=True)
class Import:
    """One import: by which module, on which line, of which module below the package, and of which name there."""

    by: str
    line: int
    module: str
    name: str = ""


def rooms(project: Path) -> dict[str, int]:
    """Every room and its layer, 0 the highest; sister rooms have the same."""
    found = tomllib.loads(project.read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    layers = next(one["layers"] for one in found if one["type"] == "layers")
    return {room.strip(): k for k, layer in enumerate(layers) for room in layer.split("|")}


def imports(module: str, tree: ast.AST, house: Path) -> Iterator[Import]:
    """Imports of the package's own modules, wherever they stand and however they are spelt."""
    here = module.split(".")
    package = here if (house / Path(*here) / "__init__.py").is_file() else here[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            path = [*above, *(node.module.split(".") if node.module else [])]
            if not node.level and path.pop(0) != "mapweave":
                continue
            for alias in node.names:
                inner = house.joinpath(*path, alias.name)
                if inner.with_suffix(".py").is_file() or inner.is_dir():
                    yield Import(module, node.lineno, ".".join([*path, alias.name]))
                else:
                    yield Import(module, node.lineno, ".".join(path), alias.name)
        elif isinstance(node, ast.Import):
            ours = [alias.name for alias in node.names if alias.name.startswith("mapweave.")]
            yield from (Import(module, node.lineno, name.removeprefix("mapweave.")) for name in ours)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and (m := DOTTED.fullmatch(node.value)):
            yield Import(module, node.lineno, m[1] + m[2])
        elif (text := _by_name(node)).startswith("."):
            yield Import(module, node.lineno, text.lstrip("."))  # type: ignore[attr-defined]


def _by_name(node: ast.AST) -> str:
    """The module that a call of `import_module` or `__import__` imports, "" where it is none."""
    if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith(("import_module", "__import__")):
        return ""
    return next((str(arg.value) for arg in node.args[:1] if isinstance(arg, ast.Constant)), "")


def offences(house: Path, project: Path) -> list[str]:
    """Every break of the contract, as `module:line: what is wrong`."""
    layer = rooms(project)
    told: list[str] = []
    known: dict[str, set[str]] = {}
    for path in sorted(house.rglob("*.py")):
        module = ".".join(path.relative_to(house).with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        mine = list(imports(module, tree, house))
        known[module] = {one.module for one in mine if one.module != module}
        room = module.partition(".")[0]
        if room not in layer:
            continue
        told += [f"{module}:{one.line}: {wrong}" for one in mine if (wrong := _across(one, room, layer))]
        told += _libraries(module, tree)
        if room in ESTIMATORS:
            told += [f"{module}:{line}: an estimator {what}" for line, what in _world(module, tree)]
    return told + [f"{' <-> '.join(circle)}: a circle" for circle in circles(known)]


def _across(one: Import, room: str, layer: dict[str, int]) -> str:
    """What is wrong with an import of another room, "" where nothing is."""
    other = one.module.partition(".")[0]
    if other == room or other not in layer:
        return ""
    if layer[other] < layer[room]:
        return f"{other} stands above"
    if layer[other] == layer[room]:
        return f"{other} is a sister room"
    private = [part for part in (*one.module.split("."), one.name) if part.startswith("_") and not part.endswith("__")]
    return f"{private[0]} is {other}'s own" if private and one.module != "kernels._jit" else ""


def _libraries(module: str, tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        names += [text] if (text := _by_name(node)) else []
        for name in names:
            homes = HOMES.get(name.partition(".")[0])
            if homes and not any(module == home or module.startswith(f"{home}.") for home in homes):
                yield f"{module}:{node.lineno}: {name} is imported in {', '.join(homes)} alone"  # type: ignore[attr-defined]


def _world(module: str, tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Where an estimator asks the world: a file, a clock, the terminal. What is true stands above it anyway."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "time" and module not in TIMED:
            yield node.lineno, "reads a clock"
        if not isinstance(node, ast.Call):
            continue
        owner, _, name = ast.unparse(node.func).rpartition(".")
        if name == "print" or owner in {"sys.stdout", "sys.stderr"}:
            yield node.lineno, "prints"
        elif name in CLOCKS and owner in {"time", "datetime", "datetime.datetime", "dt.datetime"}:
            yield node.lineno, "reads a clock"
        elif name in FILES and (owner in OWNERS or name == "open" or "_" in name):
            yield node.lineno, "opens a file"


def circles(known: dict[str, set[str]]) -> list[list[str]]:
    """Modules that import each other, round and round; each circle once, in order of names."""
    reach = {module: _reached(module, known) for module in known}
    found = {tuple(sorted(b for b in reach[a] if a in reach.get(b, ()))) for a in known if a in reach[a]}
    return [list(circle) for circle in sorted(found)]


def _reached(module: str, known: dict[str, set[str]]) -> set[str]:
    """Every module that is imported from `module` on."""
    out: set[str] = set()
    waiting = [module]
    while waiting:
        new = known.get(waiting.pop(), set()) - out
        out |= new
        waiting += new
    return out


def main() -> None:
    found = offences(TOP / "src" / "mapweave", TOP / "pyproject.toml")
    print("\n".join(found) or "every room keeps the contract")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
