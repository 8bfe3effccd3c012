"""Numbers at the top of a module: thresholds stand in the configuration, what stays says what it is."""

import ast
from pathlib import Path

import mapweave

HOUSE = Path(mapweave.__file__).parent
FACES = {"io", "papers", "report", "viewer", "cli", "live", "sim"}  # whole numbers there are formats, counts and codes
LITERALS = (ast.Constant, ast.Tuple, ast.List, ast.Dict, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.Load)


def is_number(value, *, whole):
    """Whether an expression is a number, or numbers put together, with nothing called or named; `whole`: ints too."""
    parts, kinds = list(ast.walk(value)), {int, float} if whole else {float}
    numbers = [p.value for p in parts if isinstance(p, ast.Constant) and type(p.value) in kinds]
    return bool(numbers) and all(isinstance(p, LITERALS) for p in parts)


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


def test_a_bare_number_is_found():
    assert unexplained("GATE = 3.0\n") == ["GATE"]
    assert unexplained("NEAR, FAR = 0.5, -2 * 3\n") == ["(NEAR, FAR)"]
    assert unexplained("GATE: float = 3.0\n") == ["GATE"]
    assert not unexplained("GATE = 3.0  # standard deviations\n# of its length [m]\nSIDE = 4\nNAME = 'x'\n")
    assert not unexplained("VERSION = 3\n", whole=False)
    assert not unexplained("FLAG = True\nCFG = Config(gate=3.0)\n")
