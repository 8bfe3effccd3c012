"""Swarm tables as `locate` reads them: sightings, truth, odometry."""

from pathlib import Path

import numpy as np

from ..core.bearings import BearingTable
from ..core.errors import UsageError
from .directory import result_file
from .table import write_table


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
        write_table(path, list(columns), zip(*columns.values(), strict=True))


def _write_parquet(path: Path, columns: dict[str, list]) -> None:
    try:
        import pyarrow as pa  # noqa: PLC0415  (an extra: only Parquet files need it)
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise UsageError(f"{path}: Parquet needs pyarrow: pip install 'mapweave[parquet]'") from None
    with result_file(path) as work:
        parquet.write_table(pa.table(columns), work)
