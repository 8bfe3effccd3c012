"""Position fixes as part of numbered messages, and these as fixes again: the same, to the bit."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.fixes import Fixes
from .messages import FixSource, RefusedError, pack, unpack

UNTOLD = -1.0  # variance of a fix of which the log says none


def source_of(fixes: Fixes | None) -> FixSource | None:
    """What a header tells of them."""
    if fixes is None:
        return None
    return FixSource(
        frame=fixes.frame, topic=fixes.topic, antenna=tuple(fixes.antenna.tolist()), dropped=dict(fixes.dropped)
    )


def cuts_of(fixes: Fixes | None, cuts: Float[np.ndarray, " n"]) -> list[int]:
    """Where the fixes of each message begin that holds what came by the next of `cuts` [s], and where the last ends."""
    t = np.zeros(0) if fixes is None else fixes.t
    return [0, *np.searchsorted(t, cuts, side="right").tolist(), len(t)]


def packed(fixes: Fixes | None, first: int, last: int) -> bytes:
    """The fixes `first` to `last`: columns t, place, variances."""
    if fixes is None or last <= first:
        return b""
    return pack(*fix_columns(fixes)[:, first:last])


def fix_columns(fixes: Fixes) -> Float[np.ndarray, "7 n"]:
    """Columns t, place, variances."""
    P = fixes.cov[:, [0, 0, 1], [0, 1, 1]]
    return np.vstack([fixes.t, fixes.place.T, np.where(np.isfinite(P).all(axis=1)[:, None], P, UNTOLD).T])


class FixRecord:
    """How far a robot's fixes came."""

    def __init__(self, source: FixSource | None) -> None:
        self._announced, self._t = source is not None, -np.inf

    def add(self, told: bytes) -> Float[np.ndarray, "7 n"]:
        """The columns; raises RefusedError when they can't go on from those before."""
        columns = unpack(told, 7)
        if columns.shape[1] and not self._announced:
            raise RefusedError("sensor", "position fixes from a robot that announced none")
        if not (np.diff(np.concatenate([[self._t], columns[0]])) >= 0).all():
            raise RefusedError("malformed", "position fixes that step back in time")
        self._t = float(columns[0, -1]) if columns.shape[1] else self._t
        return columns


def fixes_of(source: FixSource | None, parts: Sequence[Float[np.ndarray, "7 _"]]) -> Fixes | None:
    """The fixes that these columns tell; None of a robot that announced none."""
    if source is None:
        return None
    t, x, y, z, xx, xy, yy = np.concatenate([np.zeros((7, 0)), *parts], axis=1)
    cov = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    cov[xx < 0] = np.nan
    return Fixes(
        t, np.column_stack([x, y, z]), cov, np.array(source.antenna), source.frame, source.topic, dict(source.dropped)
    )


def joined_fixes(source: FixSource | None, parts: Sequence[Fixes]) -> Fixes | None:
    """Those of messages one after the other as one, of what `source` says they are."""
    none = fixes_of(source, [])
    if none is None or not parts:
        return none
    t, place, cov = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "place", "cov"))
    return replace(none, t=t, place=place, cov=cov)
