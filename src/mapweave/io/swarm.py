"""Swarm tables as `locate` reads them: sightings, truth, odometry."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..core.bearings import BearingTable
from ..core.errors import UsageError
from .directory import result_file


def write_sightings(path: Path, table: BearingTable) -> None:
    """`[t,]observer,target,bearing|azimuth,elevation,sigma`: CSV, or Parquet by its suffix."""
    azimuth = table.bearing()
    columns: dict[str, list] = {
        "observer": [table.ids[k] for k in table.observer.tolist()],
        "target": [table.ids[k] for k in table.target.tolist()],
    }
    if table.dim == 2:
        columns["bearing"] = azimuth.tolist()
    else:
        columns["azimuth"] = azimuth.tolist()
        columns["elevation"] = np.arcsin(np.clip(table.direction[:, 2], -1.0, 1.0)).tolist()
    if not np.isnan(table.sigma).all():
        columns["sigma"] = table.sigma.tolist()
    if table.t is not None:
        columns["t"] = table.t.tolist()
    if path.suffix.lower() in (".parquet", ".pq"):
        _write_parquet(path, columns)
    else:
        write_csv(path, list(columns), zip(*columns.values(), strict=True))


def write_csv(path: Path, head: list[str], rows: Iterable[Iterable[object]]) -> None:
    """A CSV table, whole or not at all; floats with nine digits after the point, None and NaN as nothing."""
    with result_file(path) as work, work.open("w", encoding="utf-8", newline="") as out:
        out.write(",".join(head) + "\n")
        out.writelines(",".join(map(_word, row)) + "\n" for row in rows)


def _word(value: object) -> str:
    if isinstance(value, float):
        if value != value:  # noqa: PLR0124  (NaN)
            return ""
        return f"{value:.9f}" if 1.0 <= abs(value) < 1e9 or value == 0.0 else f"{value:.12g}"
    return "" if value is None else str(value)


def _write_parquet(path: Path, columns: dict[str, list]) -> None:
    try:
        import pyarrow as pa  # noqa: PLC0415  (an extra: only Parquet files need it)
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise UsageError(f"{path}: Parquet needs pyarrow: pip install 'mapweave[parquet]'") from None
    with result_file(path) as work:
        parquet.write_table(pa.table(columns), work)
