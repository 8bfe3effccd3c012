"""What `locate` found: for programs, for files and for people."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .. import __version__
from ..core.gaussian import chi2_quantile
from ..estimate.swarm_track import SwarmTrack
from ..maps.network import Network
from ..maps.swarm import Status, SwarmEstimate
from ..readers.sightings import SwarmTruth
from ..report.swarm import MovedStory, NetworkStory, write_moved_report, write_network_report
from ..writers.directory import write_json
from ..writers.positions import write_positions, write_track
from .swarm_input import SwarmInput
from .swarm_score import SwarmScore

LISTED = 1000  # dropped rows named in metrics.json
EMPTY = {"rmse": None, "crlb_rmse": None, "rmse_over_crlb": None, "nees_per_dof": None}


@dataclass(frozen=True, slots=True)
class Settings:
    """How `locate` was asked; `timing` [s] by stage is filled in as it runs."""

    method: str
    seed: int
    timing: dict[str, float] = field(default_factory=dict)
    truth: SwarmTruth | None = None


@dataclass(frozen=True, slots=True)
class Located:
    """Robots that stand still: one position each."""

    given: SwarmInput
    settings: Settings
    network: Network
    estimate: SwarmEstimate
    score: SwarmScore | None

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.given.told, *self.estimate.warnings)

    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        e = self.estimate
        return {
            **_head(self.given, self.settings),
            **(EMPTY if self.score is None else self.score.as_json()),
            "iterations": e.iterations,
            "status": str(e.status),
            "chi2": e.chi2,
            "dof": e.dof,
            "gauge": e.gauge,
            "null_space": e.null_space,
            "not_localisable": list(e.not_localisable),
            "reliable": e.reliable,
            "weak_anchors": e.weak_anchors,
            "mode_share": e.mode_share,
            "outliers": int(e.outlier.sum()),
            "traffic": None
            if e.traffic is None
            else {"rounds": e.traffic.rounds, "messages": e.traffic.messages, "bytes": e.traffic.bytes},
            "moving": False,
            "warnings": list(self.warnings),
            "timing": self.settings.timing,
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        e = self.estimate
        told = [
            (
                f"{len(e.ids)} robots in {e.dim}D, {len(self.network.observer)} sightings, {_sigma(self.given)}, "
                f"{len(self.given.anchors)} anchors, method {e.method}: {e.status} after {e.iterations} iterations"
            )
        ]
        told += _dropped(self.given)
        if e.gauge:
            told.append(f"without enough anchors the answer is the shape alone: {e.gauge}")
        if e.cov is not None:
            free = e.localisable & ~e.anchor
            if free.any():
                std = float(np.sqrt(np.trace(e.cov[free], axis1=1, axis2=2).mean()))
                unit = "" if "scale free" in e.gauge else " m"
                told.append(f"estimated standard deviation of a position: {std:.4g}{unit} (rms)")
        lost = e.not_localisable
        if lost:
            told.append(
                f"{len(lost)} robots cannot be located: {', '.join(lost[:20])}{', ..' if len(lost) > 20 else ''}"
            )
        told.append(
            f"chi-square {e.chi2:.4g} with {e.dof} degrees of freedom, {int(e.outlier.sum())} outliers: "
            f"{'reliable' if e.reliable else 'NOT reliable'}"
        )
        if e.traffic:
            told.append(
                f"{e.traffic.rounds} rounds, {e.traffic.messages} messages, {e.traffic.bytes} bytes between robots"
            )
        if self.score is not None:
            told += self.score.lines()
        return [*told, *(f"warning: {text}" for text in self.warnings)]

    def write(self, out: Path) -> None:
        """positions.csv, metrics.json, report.html, figures/ and, for stamped sightings, trajectories/."""
        e = self.estimate
        seen, wild = self.counts()
        write_positions(
            out / "positions.csv", e.ids, e.position, e.cov, e.localisable, seen, wild, e.heading, e.heading_var
        )
        t = self.given.table.t
        if t is not None:
            for k, name in enumerate(e.ids):
                rows = (self.given.table.observer == k) | (self.given.table.target == k)
                at = np.unique(t[rows])
                place = np.tile(e.position[k], (len(at), 1))
                cov = None if e.cov is None else np.tile(e.cov[k], (len(at), 1, 1))
                write_track(out / "trajectories" / f"{_file(name)}.csv", at, place, cov)
        write_network_report(out, self.story(), self.lines(), self.metrics())
        _write_rest(out, self.given, self.metrics())

    def counts(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Sightings each robot has a part in, and how many of them are outliers."""
        return _counts(len(self.estimate.ids), self.network.observer, self.network.target, self.estimate.outlier)

    def story(self) -> NetworkStory:
        score = self.score
        return NetworkStory(
            self.network,
            self.estimate,
            None if score is None else score.truth,
            None if score is None else score.aligned,
        )


@dataclass(frozen=True, slots=True)
class Moved:
    """Robots that move: a track each. truth: by robot index, the true positions at the track's stamps."""

    given: SwarmInput
    settings: Settings
    track: SwarmTrack
    score: SwarmScore | None
    truth: Mapping[int, Float[np.ndarray, "k d"]]

    @property
    def reliable(self) -> bool:
        return self.track.converged and self.track.chi2 <= chi2_quantile(0.999, max(float(self.track.dof), 1.0))

    @property
    def not_localisable(self) -> tuple[str, ...]:
        """Robots without a track, and those whose positions are less sure than the swarm is wide."""
        tracks = self.track.tracks
        everywhere = np.concatenate([one.position for one in tracks.values()])
        width = float(np.linalg.norm(np.quantile(everywhere, 0.9, axis=0) - np.quantile(everywhere, 0.1, axis=0)))
        lost = []
        for k, name in enumerate(self.given.table.ids):
            one = tracks.get(k)
            if one is None or (one.cov is not None and np.sqrt(np.trace(one.cov, axis1=1, axis2=2)).min() > width):
                lost.append(name)
        return tuple(lost)

    @property
    def warnings(self) -> tuple[str, ...]:
        told = [*self.given.told, *self.track.warnings]
        if not self.track.converged:
            told.append("the smoothing did not converge")
        elif not self.reliable:
            ratio = self.track.chi2 / max(self.track.dof, 1)
            told.append(
                f"residuals are {ratio:.3g} times what sigma and the motion model say: covariances are too small"
            )
        return tuple(told)

    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        t = self.track
        names = self.given.table.ids
        return {
            **_head(self.given, self.settings),
            **(EMPTY if self.score is None else self.score.as_json()),
            "iterations": t.iterations,
            "status": str(Status.CONVERGED if t.converged else Status.ITERATION_LIMIT),
            "chi2": t.chi2,
            "dof": t.dof,
            "gauge": t.gauge,
            "null_space": None,
            "not_localisable": list(self.not_localisable),
            "reliable": self.reliable,
            "outliers": int(t.outlier.sum()),
            "moving": True,
            "odometry_scale": None
            if t.scale is None
            else {names[k]: [v, w] for k, (v, w) in sorted(t.scale.items()) if (v, w) != (1.0, 1.0)},
            "warnings": list(self.warnings),
            "timing": self.settings.timing,
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        t = self.track
        knots = sum(len(one.t) for one in t.tracks.values())
        told = [
            (
                f"{len(self.given.table.ids)} moving robots in {self.given.table.dim}D, "
                f"{len(self.given.table.observer)} sightings, {_sigma(self.given)}, {len(self.given.anchors)} anchors: "
                f"{knots} positions, {t.method}, "
                f"{t.iterations} iterations"
            )
        ]
        told += _dropped(self.given)
        if t.gauge:
            told.append(t.gauge)
        if self.not_localisable:
            told.append(f"{len(self.not_localisable)} robots cannot be located: {', '.join(self.not_localisable[:20])}")
        told.append(
            f"chi-square {t.chi2:.4g} with {t.dof} degrees of freedom, {int(t.outlier.sum())} outliers: "
            f"{'reliable' if self.reliable else 'NOT reliable'}"
        )
        if self.score is not None:
            told += self.score.lines()
        return [*told, *(f"warning: {text}" for text in self.warnings)]

    def write(self, out: Path) -> None:
        """trajectories/ID.csv, positions.csv (each robot's last), metrics.json, report.html and figures/."""
        table, tracks = self.given.table, self.track.tracks
        n, d = len(table.ids), table.dim
        last, cov, found = np.full((n, d), np.nan), np.full((n, d, d), np.nan), np.zeros(n, dtype=bool)
        lost = set(self.not_localisable)
        for k, one in tracks.items():
            write_track(out / "trajectories" / f"{_file(table.ids[k])}.csv", one.t, one.position, one.cov, one.heading)
            last[k], found[k] = one.position[-1], table.ids[k] not in lost
            if one.cov is not None:
                cov[k] = one.cov[-1]
        seen, wild = _counts(n, table.observer, table.target, self.track.outlier)
        write_positions(out / "positions.csv", table.ids, last, cov, found, seen, wild)
        story = MovedStory(table.ids, self.track, self.given.anchors, self.truth if self.score is not None else {})
        write_moved_report(out, story, self.lines(), self.metrics())
        _write_rest(out, self.given, self.metrics())


def _head(given: SwarmInput, settings: Settings) -> dict[str, Any]:
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


def _write_rest(out: Path, given: SwarmInput, metrics: dict[str, Any]) -> None:
    if given.dropped:
        from ..writers.swarm import write_csv  # noqa: PLC0415

        rows = [(r.line, r.observer, r.target, r.reason) for r in given.dropped]
        write_csv(out / "dropped.csv", ["line", "observer", "target", "reason"], rows)
    write_json(out / "metrics.json", metrics)


def _counts(
    n: int, observer: np.ndarray, target: np.ndarray, outlier: np.ndarray
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    both = np.concatenate([observer, target])
    wild = np.concatenate([outlier, outlier])
    return np.bincount(both, minlength=n), np.bincount(both[wild], minlength=n)


def _sigma(given: SwarmInput) -> str:
    told = {"default": "assumed; give --sigma", "option": "as given", "file": "from the file"}
    return f"sigma {np.degrees(given.sigma):.3g} deg ({told.get(given.sigma_source, given.sigma_source)})"


def _dropped(given: SwarmInput) -> list[str]:
    if not given.dropped:
        return []
    some = ", ".join(f"line {r.line} ({r.observer} sees {r.target}: {r.reason})" for r in given.dropped[:5])
    return [f"{len(given.dropped)} rows left out: {some}{', ..' if len(given.dropped) > 5 else ''}"]


def _file(name: str) -> str:
    """A robot's name as a file name."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)
