"""Numbers joined by commas, as options spell points and poses."""

import math

from ..core.errors import UsageError


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """`count` finite numbers; raises UsageError naming the option."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: expected {count} numbers joined by commas, found {text!r}")
    return values
