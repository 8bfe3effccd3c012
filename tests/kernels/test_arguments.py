"""Kernels take records, not long lists of arrays."""

import ast
from pathlib import Path

import mapweave.kernels

MOST = 10


def test_no_kernel_takes_more_than_ten_arguments():
    long = []
    for path in sorted(Path(mapweave.kernels.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                count = len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)
                long += [f"{path.name}: {node.name} takes {count}"] if count > MOST else []
    assert not long, "\n".join(long)
