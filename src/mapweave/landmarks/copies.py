"""Logs that are one log under two names: shifted in time, without its own robot's sightings, or a part of it.

Two robots never measure the same numbers twice in a row. So pairs of successive sightings that two logs both hold, to
the bit, tell a copy; a copy counts once, as the same file given twice does.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.landmark_log import LandmarkLog


@config
class CopiesConfig:
    """When two logs are one log under two names."""

    pairs: int = 20  # successive pairs of sightings of the shorter log, from which logs are compared
    share: float = 0.5  # of them that the other must hold too
    varied: float = 0.5  # share of a log's pairs that must differ from each other: constant numbers prove nothing


COPIES = CopiesConfig()


def with_copies_marked(logs: Sequence[LandmarkLog], cfg: CopiesConfig = COPIES) -> list[LandmarkLog]:
    """The logs in their order; one that repeats an earlier one carries its hash and a warning."""
    seen = [_successive(log, cfg) for log in logs]
    known: list[LandmarkLog] = []
    for k, log in enumerate(logs):
        first = next((i for i in range(k) if _same(seen[i], seen[k], cfg)), None)
        if first is None or known[first].log_hash == log.log_hash:
            known.append(log)
            continue
        told = f"its sightings are those of {logs[first].robot}: one log under two names, counted once"
        known.append(replace(log, log_hash=known[first].log_hash, warnings=(*log.warnings, told)))
    return known


def _successive(log: LandmarkLog, cfg: CopiesConfig) -> Float[np.ndarray, "n 4"]:
    """Range and bearing of every sighting and of the next, each such pair once; none where most repeat others."""
    tables = [s for s in (log.sightings, log.bearings) if len(s)]
    rows = [np.column_stack([np.nan_to_num(s.range), s.bearing]) for s in tables]
    pairs = np.concatenate([np.zeros((0, 4)), *(np.hstack([r[:-1], r[1:]]) for r in rows)])
    once = np.unique(pairs, axis=0)
    return once if len(once) >= cfg.varied * len(pairs) else np.zeros((0, 4))


def _same(a: Float[np.ndarray, "n 4"], b: Float[np.ndarray, "m 4"], cfg: CopiesConfig) -> bool:
    least = min(len(a), len(b))
    if least < cfg.pairs:
        return False
    return len(a) + len(b) - len(np.unique(np.concatenate([a, b]), axis=0)) >= cfg.share * least
