"""What a command prints for people to read."""

from collections.abc import Sequence


def say(line: str = "") -> None:
    """One line on stdout."""
    print(line)  # noqa: T201


def say_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Columns as wide as they need to be, numbers right."""
    text = [[_cell(v) for v in row] for row in rows]
    width = [max(len(h), *(len(row[k]) for row in text)) if text else len(h) for k, h in enumerate(head)]
    for line in [list(head), *text]:
        say("  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(line, width, strict=True))))


def _cell(value: object) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
