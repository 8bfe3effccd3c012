"""What one scan did to the estimate, and how poses between corrections are filled in."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core import se2


@dataclass(frozen=True, slots=True)
class ScanInfo:
    """One row of the per-scan record; see `ScanRecords` for the words."""

    innovation: Float[np.ndarray, "3"]
    beams: int
    matches: int
    decision: str
    n_eff: float = np.nan
    resampled: bool = False
    information: Float[np.ndarray, "3 3"] | None = None


def blended(
    carrier: Float[np.ndarray, "n 3"], at: Int[np.ndarray, " k"], corrected: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "n 3"]:
    """Poses along `carrier` (a drifting trajectory, in order) that pass through `corrected` at its rows `at`.

    Between two corrected rows the pose is carried from both and blended by the share of the way; before the first and
    after the last it is carried from the one there is. at: ascending, k >= 1.
    """
    n = len(carrier)
    step = se2.between(carrier[:-1], carrier[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + 0.5 * np.abs(step[:, 2]) + 1e-6)])
    before = np.searchsorted(at, np.arange(n), side="right") - 1
    first, second = np.maximum(before, 0), np.minimum(before + 1, len(at) - 1)
    i, j = at[first], at[second]
    a = se2.compose(corrected[first], se2.between(carrier[i], carrier))
    b = se2.compose(corrected[second], se2.between(carrier[j], carrier))
    share = np.where(j > i, (way - way[i]) / np.maximum(way[j] - way[i], 1e-12), 0.0)
    d = b - a
    d[:, 2] = se2.wrap_angle(d[:, 2])
    out = a + np.clip(share, 0.0, 1.0)[:, None] * d
    out[:, 2] = se2.wrap_angle(out[:, 2])
    return np.asarray(out)
