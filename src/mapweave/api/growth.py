"""How a map grew while the logs played: what the first so many seconds of all of them give, again and again."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..core.errors import MapweaveError, UsageError
from ..core.workers import Progress

MOST_LOOKS = 1000  # maps that are made on the way, at most

Span = tuple[float, float]
Look = Callable[[list[float]], dict[str, Any]]


def grown(
    spans: Sequence[Span], every: float, look: Look, at_last: dict[str, Any], on_progress: Progress
) -> list[dict[str, Any]]:
    """What `look` tells of the logs up to every moment, `every` seconds apart, `t` [s] after the first row of all.

    spans: first and last stamp of each log; look: takes the stamp up to which each log is asked; at_last: what it would
    tell of them whole. Logs that nobody recorded at the same time are each asked up to as long after its own beginning.
    What cannot be mapped yet is told as `refused`. Raises UsageError where that were more than `MOST_LOOKS` maps.
    """
    first, last = np.array(spans, dtype=float).T
    began = np.full(len(first), first.min()) if first.max() < last.min() else first
    whole = float((last - began).max())
    if whole / every > MOST_LOOKS:
        raise UsageError(f"--every: {every:g} s of {whole:.0f} s are over {MOST_LOOKS} maps on the way")
    times = np.arange(every, whole, every)
    rows = []
    for k, t in enumerate(times.tolist()):
        on_progress("growth", k, len(times))
        try:
            row = look((began + t).tolist())
        except MapweaveError as error:
            row = {"robots": 0, "maps": 0, "refused": str(error)}
        rows.append({"t": t, **row})
    on_progress("growth", len(times), len(times))
    return [*rows, {"t": whole, **at_last}]
