"""Relations files: `t1 t2 x y z roll pitch yaw`, plain or gzipped, `#` comments."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError
from ..core.truth import Relations
from .files import TextLog
from .table import open_text, write_rows


def is_relations(path: Path) -> bool:
    """By name (`.relations`, `.relations.gz`, `relations.gz`, ...)."""
    return path.is_file() and any(part == "relations" for part in path.name.lower().split("."))


def read_relations(path: Path) -> Relations:
    """All rows, in the file's order. Raises ReaderError naming the first line that is not eight finite numbers."""
    log = TextLog(path)
    if log.truncated:
        raise ReaderError(path, log.truncated)
    rows = []
    for number, line in log.lines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise ReaderError(
                path, f"expected numbers `t1 t2 x y z roll pitch yaw`, found {line[:60]!r}", number
            ) from None
        if len(row) != 8 or not np.isfinite(row).all():
            raise ReaderError(path, f"expected 8 finite numbers `t1 t2 x y z roll pitch yaw`, found {len(row)}", number)
        rows.append(row)
    if not rows:
        raise ReaderError(path, "expected relations, found none")
    a = np.array(rows)
    return Relations(a[:, 0], a[:, 1], a[:, [2, 3, 7]], str(path))


def write_relations(
    path: Path, t1: Float[np.ndarray, " n"], t2: Float[np.ndarray, " n"], motion: Float[np.ndarray, "n 3"]
) -> None:
    """`path` holds a line for each motion [x, y, theta] from `t1` to `t2`, with as many digits as the numbers have."""
    with open_text(path) as file:
        write_rows(file, "%.17g %.17g %.17g %.17g 0 0 0 %.17g\n", np.column_stack([t1, t2, motion]))
