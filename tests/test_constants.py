"""Numbers at the top of a module: thresholds stand in the configuration, what stays says what it is."""

import ast
from dataclasses import fields, is_dataclass
from pathlib import Path

import mapweave
from mapweave.api.configuration import JOBS, configuration_class

HOUSE = Path(mapweave.__file__).parent
FACES = {"io", "papers", "report", "viewer", "cli", "live", "sim"}  # whole numbers there are formats, counts and codes
# rooms whose thresholds decide results
ESTIMATING = ("landmarks", "fusion", "laser", "mapping", "swarm", "team", "exploration")
COMPUTING = (*ESTIMATING, "kernels", "solve")  # and those that work for them
SCALE = 1e-3, 1e3  # what lies outside is so small or so large that it stands for nothing or for everything
DEFAULTS = {
    # floats that an argument has by itself in those rooms, and why
    "swarm/headings.py: relative_odometry_frame(limit)": "callers in the package name their own",
    "swarm/filtered.py: filter_start(sigma)": "the paper's",
}
LITERALS = (ast.Constant, ast.Tuple, ast.List, ast.Dict, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.Load)


def is_number(value, *, whole):
    """Whether an expression is a number, or numbers put together, with nothing called or named; `whole`: ints too."""
    parts, kinds = list(ast.walk(value)), {int, float} if whole else {float}
    numbers = [p.value for p in parts if isinstance(p, ast.Constant) and type(p.value) in kinds]
    return bool(numbers) and all(isinstance(p, LITERALS) for p in parts)


def float_defaults(source):
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


def unexplained(source, *, whole=True):
    """Names given numbers at the top level of `source` without a comment on their lines or on the line above."""
    lines, found = source.splitlines(), []
    for node in ast.parse(source).body:
        if (
            not isinstance(node, ast.Assign | ast.AnnAssign)
            or node.value is None
            or not is_number(node.value, whole=whole)
        ):
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        own = lines[node.lineno - 1 : node.end_lineno]
        above = lines[node.lineno - 2].strip() if node.lineno > 1 else ""
        if not any("# " in line for line in own) and not above.startswith("#"):
            found.append(ast.unparse(target))
    return found


def test_every_number_at_the_top_of_a_module_says_what_it_is():
    told = []
    for path in sorted(HOUSE.rglob("*.py")):
        place = path.relative_to(HOUSE)
        told += [f"{place}: {name}" for name in unexplained(path.read_text(), whole=place.parts[0] not in FACES)]
    assert not told, "\n".join(told)


def test_no_threshold_hides_as_the_default_of_an_argument():
    found = set()
    for room in COMPUTING:
        for path in (HOUSE / room).rglob("*.py"):
            found |= {f"{path.relative_to(HOUSE)}: {name}" for name in float_defaults(path.read_text())}
    assert found == set(DEFAULTS)


def test_every_class_of_settings_of_the_estimating_rooms_is_printed_for_some_job():
    printed, waiting = set(), [configuration_class(job, laser=laser)() for job, laser in JOBS]
    while waiting:
        cfg = waiting.pop()
        printed.add(type(cfg).__name__)
        waiting += [value for f in fields(cfg) if is_dataclass(value := getattr(cfg, f.name))]
    # what another inherits, made from others' fields, of `solve`, and worlds that a file tells
    own = {"LaserTrackingConfig", "RelativeConfig", "RobustGraphConfig", "ScenarioConfig", "LaserScenarioConfig"}
    own |= {"WorldConfig"}
    classes = []
    for path in (p for room in ESTIMATING for p in (HOUSE / room).rglob("*.py")):
        made = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ClassDef)]
        classes += [c.name for c in made if any(ast.unparse(d) == "config" for d in c.decorator_list)]
    assert len(classes) > 40
    assert set(classes) - printed == own


def test_a_bare_number_is_found():
    assert unexplained("GATE = 3.0\n") == ["GATE"]
    assert unexplained("NEAR, FAR = 0.5, -2 * 3\n") == ["(NEAR, FAR)"]
    assert unexplained("GATE: float = 3.0\n") == ["GATE"]
    assert not unexplained("GATE = 3.0  # standard deviations\n# of its length [m]\nSIDE = 4\nNAME = 'x'\n")
    assert not unexplained("VERSION = 3\n", whole=False)
    assert not unexplained("FLAG = True\nCFG = Config(gate=3.0)\n")
    assert float_defaults("def f(a, b=0.3, *, c=1.0, d=0.0, e=2.5): ...") == ["f(b)", "f(e)"]
