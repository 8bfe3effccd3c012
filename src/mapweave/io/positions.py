"""What `locate` leaves: positions with covariances, and tracks over time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from .table import write_table

ORDER = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))}
NAMES = {2: ("var_x", "cov_xy", "var_y"), 3: ("var_x", "cov_xy", "var_y", "cov_xz", "cov_yz", "var_z")}


def write_positions(
    path: Path,
    ids: Sequence[str],
    position: Float[np.ndarray, "n d"],
    cov: Float[np.ndarray, "n d d"] | None,
    localisable: Bool[np.ndarray, " n"],
    sightings: Int[np.ndarray, " n"],
    outliers: Int[np.ndarray, " n"],
    heading: Float[np.ndarray, " n"] | None = None,
    heading_var: Float[np.ndarray, " n"] | None = None,
) -> None:
    """`id,x,y[,z],var_x,..,localisable,sightings,outliers[,heading,var_heading]`; what is not known stays empty."""
    n, d = position.shape
    head = ["id", *"xyz"[:d], *NAMES[d], "localisable", "sightings", "outliers"]
    spread = np.full((n, len(NAMES[d])), np.nan) if cov is None else np.stack([cov[:, a, b] for a, b in ORDER[d]], 1)
    columns = [list(ids), *position.T.tolist(), *spread.T.tolist()]
    columns += [localisable.astype(int).tolist(), sightings.tolist(), outliers.tolist()]
    if heading is not None:
        head += ["heading", "var_heading"]
        columns += [heading.tolist(), (np.full(n, np.nan) if heading_var is None else heading_var).tolist()]
    write_table(path, head, zip(*columns, strict=True))


def write_track(
    path: Path,
    t: Float[np.ndarray, " k"],
    position: Float[np.ndarray, "k d"],
    cov: Float[np.ndarray, "k d d"] | None,
    heading: Float[np.ndarray, " k"] | None = None,
) -> None:
    """`t,x,y[,z],var_x,..[,heading]`: one robot over time."""
    d = position.shape[1]
    head = ["t", *"xyz"[:d], *NAMES[d]]
    spread = (
        np.full((len(t), len(NAMES[d])), np.nan) if cov is None else np.stack([cov[:, a, b] for a, b in ORDER[d]], 1)
    )
    columns = [t.tolist(), *position.T.tolist(), *spread.T.tolist()]
    if heading is not None:
        head.append("heading")
        columns.append(heading.tolist())
    write_table(path, head, zip(*columns, strict=True))
