"""Scores of what `locate` wrote, against the truth `id,x,y[,z]` (with `t` for robots that moved)."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError, ReaderError
from ..evaluation.swarm import paper_errors, rms, similarity
from ..io.positions import NAMES, ORDER
from ..io.sightings import read_swarm_truth
from ..io.table import Table, read_table
from .swarm_score import fitted, marginal_nees, over_time, places_of


@dataclass(frozen=True, slots=True)
class SwarmEvaluation:
    """Errors [m] of robots that are located, no anchors, and in the truth."""

    rmse: float | None
    nees_per_dof: float | None
    distance_error: float | None
    angle_error_deg: float | None
    alignment: str
    robots: int
    not_localisable: int
    without_truth: int

    def as_json(self) -> dict[str, Any]:
        return {
            "rmse": self.rmse,
            "nees_per_dof": self.nees_per_dof,
            "distance_error": self.distance_error,
            "angle_error_deg": self.angle_error_deg,
            "alignment": self.alignment,
            "robots": self.robots,
            "not_localisable": self.not_localisable,
            "robots_without_truth": self.without_truth,
        }

    def lines(self) -> list[str]:
        def say(value: float | None) -> str:
            return "-" if value is None else f"{value:.4g}"

        told = [
            f"RMSE {say(self.rmse)} m over {self.robots} robots, NEES per degree of freedom {say(self.nees_per_dof)}"
        ]
        if self.distance_error is not None:
            told.append(f"distance error {say(self.distance_error)} m, angle error {say(self.angle_error_deg)} deg")
        if self.alignment != "none":
            told.append(f"scored after fitting {self.alignment} to the truth")
        return told


def applies(directory: Path, truth: Path) -> bool:
    """Whether `directory` is what `locate` wrote and `truth` a table of robots."""
    if not (directory / "positions.csv").is_file() or not truth.is_file():
        return False
    with truth.open(encoding="utf-8-sig", errors="replace") as file:
        head = {word.strip().lower() for word in file.readline().split(",")}
    return {"id", "x", "y"} <= head or truth.suffix.lower() in (".parquet", ".pq")


def evaluate(directory: Path, truth: Sequence[Path]) -> SwarmEvaluation:
    """The score; NEES from each robot's own covariance (the joint one is not on disk)."""
    try:
        metrics = json.loads((directory / "metrics.json").read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReaderError(directory / "metrics.json", f"expected JSON: {error}") from None
    true = read_swarm_truth(truth[0])
    table = read_table(directory / "positions.csv")
    ids = table.names("id")
    dim = 3 if "z" in table.columns else 2
    known = set(metrics.get("anchors", []))
    gauge = str(metrics.get("gauge", ""))
    if not set(true.ids) & set(ids):
        raise DataError(f"{truth[0]}: the truth names none of the robots of {directory}")
    place, cov = _columns(table, dim)
    located = table.numbers("localisable") > 0
    if metrics.get("moving"):
        return _over_time(directory, ids, dim, located, known, gauge, true)
    there = places_of(true, ids, dim)
    have = np.isfinite(there).all(axis=1)
    fit = have & located
    use = fit & ~np.isin(np.array(ids), sorted(known))
    alignment = "none"
    if gauge and fit.sum() >= 2:
        place, alignment = fitted(place, there, fit, gauge)
    nees = None
    if not gauge and use.any() and np.isfinite(cov[use]).all():
        nees = marginal_nees(place[use] - there[use], cov[use])
    pairs = (
        np.column_stack([np.arange(fit.sum() - 1), np.arange(1, fit.sum())]) if fit.sum() > 1 else np.zeros((0, 2), int)
    )
    errors = paper_errors(place[fit], there[fit], pairs) if fit.sum() <= 40 else None
    return SwarmEvaluation(
        rms(place[use] - there[use]),
        nees,
        errors.distance if errors else None,
        errors.angle_deg if errors else None,
        alignment,
        int(use.sum()),
        int((~located).sum()),
        int((~have).sum()),
    )


def _over_time(
    directory: Path, ids: Sequence[str], dim: int, located: np.ndarray, known: set[str], gauge: str, true: Any
) -> SwarmEvaluation:
    names = np.array(true.ids)
    found, there, covs = [], [], []
    missing = 0
    for name, ok in zip(ids, located.tolist(), strict=True):
        rows = np.flatnonzero(names == name)
        path = directory / "trajectories" / f"{name}.csv"
        if name in known or not ok or not path.is_file():
            continue
        if not len(rows):
            missing += 1
            continue
        table = read_table(path)
        place, cov = _columns(table, dim)
        t = table.numbers("t")
        if true.t is None:
            at = np.broadcast_to(true.position[rows[0], :dim], place.shape)
        else:
            rows = rows[np.argsort(true.t[rows], kind="stable")]
            at = over_time(t, true.t[rows], true.position[rows, :dim])
        found.append(place)
        there.append(at)
        covs.append(cov)
    if not found:
        return SwarmEvaluation(None, None, None, None, "none", 0, int((~located).sum()), missing)
    p, q, P = np.concatenate(found), np.concatenate(there), np.concatenate(covs)
    have = np.isfinite(q).all(axis=1)
    p, q, P = p[have], q[have], P[have]
    alignment = "none"
    if gauge:
        s, R, shift = similarity(p, q, scale=False, turn=True)
        p, alignment = s * p @ R.T + shift, "place and turn"
    nees = marginal_nees(p - q, P) if not gauge and np.isfinite(P).all() else None
    return SwarmEvaluation(rms(p - q), nees, None, None, alignment, len(found), int((~located).sum()), missing)


def _columns(table: Table, dim: int) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d d"]]:
    """Positions and covariances (NaN where the table says nothing)."""
    place = np.column_stack([table.numbers(name) for name in "xyz"[:dim]])
    cov = np.full((len(table), dim, dim), np.nan)
    for name, (a, b) in zip(NAMES[dim], ORDER[dim], strict=True):
        cov[:, a, b] = cov[:, b, a] = table.numbers(name)
    return place, cov
