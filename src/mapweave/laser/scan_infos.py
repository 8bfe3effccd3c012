"""What every scan did to the estimate, kept while a log goes on: some 120 bytes a scan."""

import numpy as np
from jaxtyping import Float

from ..core.rows import RowBuffer
from .laser_map import ScanRecords
from .scan_odometry import ScanInfo

DECISIONS = ("first", "empty", "odometry", "matched", "skipped")


class ScanInfos:
    """The `ScanInfo` of every scan, 119 bytes of each. `append` and `clear` change it."""

    def __init__(self) -> None:
        self._rows = RowBuffer(
            dtype=[
                ("innovation", np.float64, 3),
                ("information", np.float64, (3, 3)),
                ("n_eff", np.float64),
                ("beams", np.int32),
                ("matches", np.int32),
                ("decision", np.uint8),
                ("resampled", np.bool_),
                ("informed", np.bool_),
            ]
        )

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, info: ScanInfo) -> None:
        """Add what the next scan did."""
        informed = info.information is not None
        self._rows.append(
            (
                info.innovation,
                info.information if informed else 0.0,
                info.n_eff,
                info.beams,
                info.matches,
                DECISIONS.index(info.decision),
                info.resampled,
                informed,
            )
        )

    def clear(self) -> None:
        """Remove all rows."""
        self._rows.clear()

    def records(self, t: Float[np.ndarray, " m"], host: tuple[str, ...], pose: Float[np.ndarray, "m 3"]) -> ScanRecords:
        """The per-scan record of scans with these stamps, hosts and poses."""
        rows = self._rows.array
        return ScanRecords(
            t,
            host,
            pose,
            rows["innovation"],
            rows["beams"].astype(np.int64),
            rows["matches"].astype(np.int64),
            tuple(DECISIONS[k] for k in rows["decision"].tolist()),
            rows["n_eff"],
            rows["resampled"],
            rows["information"] if len(rows) and rows["informed"].all() else None,
        )
