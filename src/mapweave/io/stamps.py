"""Stamps that cannot be are mended: all equal, rounded so that several rows share one, or going back.

Rows stand in a file in the order in which they were written, which is all that is left where stamps tell nothing. A row
now and then that was written a little late is in order by its stamp.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

SAME = 0.3  # share of rows that bear the stamp of the one before, from which stamps are equal or rounded
ENOUGH = 20  # rows, of fewer nobody can say that their stamps are rounded
LATE = 20  # rows by which one may be late and is sorted in
AGAIN = 0.1  # by which a leap forward may differ from the one back that it takes back
USUAL = 1.0  # [s] from row to row, where neither the log nor its other rows tell


class Mended(NamedTuple):
    """t: (n,) [s] ascending in the file's order. what: "equal", "rounded" or "back"; rows: how many it is so of."""

    t: Float[np.ndarray, " n"]
    what: str
    rows: int


def mended_stamps(
    t: Float[np.ndarray, " n"], other: Bool[np.ndarray, " n"], step: float | None = None
) -> Mended | None:
    """Stamps in the file's order, None where those of the rows are right, or are right once sorted.

    other: whether a row says something else than the row before; step: [s] from row to row as the log states it.
    """
    if len(t) < 3:
        return None
    d = np.diff(t)
    same = (d == 0) & other[1:]
    if (t == t[0]).all():
        return Mended(t[0] + _usual(d, step) * np.arange(len(t)), "equal", int(same.sum())) if same.any() else None
    if np.abs(np.argsort(t, kind="stable") - np.arange(len(t))).max() > LATE:
        back = d < 0
        return Mended(
            t[0] + np.concatenate([[0.0], np.cumsum(_forward(np.where(same, _usual(d, step), d), step))]),
            "back",
            int(back.sum()),
        )
    if len(t) < ENOUGH or same.mean() < SAME:
        return None
    return Mended(_spread(np.maximum.accumulate(t), step), "rounded", int(same.sum()))


def _usual(d: Float[np.ndarray, " m"], step: float | None) -> float:
    """[s] from row to row: as stated, or the median of those that go forward."""
    if step is not None and np.isfinite(step) and step > 0:
        return step
    return float(np.median(d[d > 0])) if (d > 0).any() else USUAL


def _forward(d: Float[np.ndarray, " m"], step: float | None) -> Float[np.ndarray, " m"]:
    """The steps, those back, and leaps forward that take one of them back, replaced by the usual one."""
    usual = _usual(d, step)
    out = np.array(d)
    for k in np.flatnonzero(d < 0).tolist():
        out[k] = usual
        near = slice(max(0, k - LATE), k + LATE)
        leaps = (d[near] > 10 * usual) & (np.abs(d[near] + d[k]) <= AGAIN * -d[k])
        out[near][leaps] = usual
    return out


def _spread(t: Float[np.ndarray, " n"], step: float | None) -> Float[np.ndarray, " n"]:
    """Rows of one stamp spread evenly until the next; those of the last as far apart as rows usually are."""
    first = np.flatnonzero(np.append(True, t[1:] > t[:-1]))
    count = np.diff(np.append(first, len(t)))
    gap = np.diff(t[first])
    usual = step if step is not None and step > 0 else float(np.median(gap / count[:-1]))
    each = np.append(np.minimum(gap / count[:-1], usual * 1.5), usual)
    inside = np.arange(len(t)) - np.repeat(first, count)
    return np.asarray(t + inside * np.repeat(each, count))


def rows_by_scanner(keys: Sequence[tuple[bytes, str]]) -> list[list[int]]:
    """The rows of each scanner and logger, in the file's order: clocks and order are theirs."""
    groups: dict[tuple[bytes, str], list[int]] = {}
    for k, key in enumerate(keys):
        groups.setdefault(key, []).append(k)
    return list(groups.values())
