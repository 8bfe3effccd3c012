"""Known places and distances as people write them."""

import math
from collections.abc import Sequence

from ..core.errors import UsageError


def parse_anchors(words: Sequence[str] | None) -> dict[str, tuple[float, ...]]:
    """`a=0,0` (or three coordinates) each; raises UsageError where one does not parse or a robot stands twice."""
    known: dict[str, tuple[float, ...]] = {}
    for word in words or ():
        name, _, rest = word.rpartition("=")
        numbers = _numbers(rest)
        if not name.strip() or numbers is None or len(numbers) not in {2, 3}:
            raise UsageError(f"--anchor {word}: expected ID=x,y or ID=x,y,z in metres, such as a=0,0")
        if name.strip() in known:
            raise UsageError(f"--anchor {word}: robot {name.strip()} is given twice")
        known[name.strip()] = numbers
    return known


def parse_distances(words: Sequence[str] | None) -> list[tuple[str, str, float]]:
    """`i,j=10` each; raises UsageError where one does not parse or is not positive."""
    apart = []
    for word in words or ():
        pair, _, rest = word.rpartition("=")
        names, numbers = [name.strip() for name in pair.split(",")], _numbers(rest)
        if len(names) != 2 or not all(names) or numbers is None or len(numbers) != 1 or numbers[0] <= 0.0:
            raise UsageError(f"--distance {word}: expected I,J=D with D metres above 0, such as a,b=10")
        if names[0] == names[1]:
            raise UsageError(f"--distance {word}: the two robots are the same")
        apart.append((names[0], names[1], numbers[0]))
    return apart


def _numbers(text: str) -> tuple[float, ...] | None:
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        return None
    return numbers if all(math.isfinite(v) for v in numbers) else None
