"""What `locate` tells of a swarm whether its robots stand or move: how it was asked, what it read, what it left out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from ..core.version import __version__
from ..io.directory import write_json
from ..io.sightings import SwarmTruth
from ..io.table import write_table
from ..swarm.config import SwarmConfig
from .swarm_input import SwarmInput

LISTED = 1000  # dropped rows named in metrics.json
NO_SCORE = {"rmse": None, "crlb_rmse": None, "rmse_over_crlb": None, "nees_per_dof": None}


@dataclass(frozen=True, slots=True)
class Settings:
    """How `locate` was asked; `timing` [s] by stage is filled in as it runs."""

    method: str
    seed: int
    timing: dict[str, float] = field(default_factory=dict)
    truth: SwarmTruth | None = None
    swarm: SwarmConfig = field(default_factory=SwarmConfig)


def head(given: SwarmInput, settings: Settings) -> dict[str, Any]:
    """What `metrics.json` says of the question and the data."""
    reasons: dict[str, int] = {}
    for row in given.dropped:
        reasons[row.reason] = reasons.get(row.reason, 0) + 1
    table = given.table
    return {
        "version": __version__,
        "seed": settings.seed,
        "method": settings.method,
        "dim": table.dim,
        "robots": len(table.ids),
        "sightings": len(table.observer),
        "anchors": [table.ids[k] for k in given.anchors],
        "axis": table.axis,
        "sigma_deg": float(np.degrees(given.sigma)),
        "sigma_source": given.sigma_source,
        "dropped": dict(sorted(reasons.items())),
        "dropped_rows": [
            {"line": row.line, "observer": row.observer, "target": row.target, "reason": row.reason}
            for row in given.dropped[:LISTED]
        ],
    }


def write_rest(out: Path, given: SwarmInput, metrics: dict[str, Any]) -> None:
    """metrics.json and, where rows were left out, dropped.csv."""
    if given.dropped:
        rows = [(r.line, r.observer, r.target, r.reason) for r in given.dropped]
        write_table(out / "dropped.csv", ["line", "observer", "target", "reason"], rows)
    write_json(out / "metrics.json", metrics)


def counts(
    n: int, observer: np.ndarray, target: np.ndarray, outlier: np.ndarray
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Sightings each of n robots has a part in, and how many of them are outliers."""
    both = np.concatenate([observer, target])
    wild = np.concatenate([outlier, outlier])
    return np.bincount(both, minlength=n), np.bincount(both[wild], minlength=n)


def sigma_text(given: SwarmInput) -> str:
    """The standard deviation of a bearing, and where it is from."""
    sources = {"default": "assumed; give --sigma", "option": "as given", "file": "from the file"}
    return f"sigma {np.degrees(given.sigma):.3g} deg ({sources.get(given.sigma_source, given.sigma_source)})"


def dropped_lines(given: SwarmInput) -> list[str]:
    """One line about rows left out, or none."""
    if not given.dropped:
        return []
    some = ", ".join(f"line {r.line} ({r.observer} sees {r.target}: {r.reason})" for r in given.dropped[:5])
    return [f"{len(given.dropped)} rows left out: {some}{', ..' if len(given.dropped) > 5 else ''}"]
