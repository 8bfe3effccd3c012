"""What `locate` found: how it was asked, what it read and left out, and where robots that stand still are."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from ..core.version import __version__
from ..evaluation.swarm import StandingScore, StandingSwarm, SwarmScore
from ..io.directory import write_json
from ..io.positions import track_files, write_network, write_positions, write_track
from ..io.sightings import SwarmTruth
from ..io.table import write_table
from ..report.result import ResultBase
from ..report.style import Target
from ..report.swarm import NetworkStory, write_network_report
from ..report.swarm_figures import network_figure
from ..swarm.config import SwarmConfig
from ..swarm.network import BearingNetwork
from ..swarm.result import SwarmEstimate
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


@dataclass(frozen=True, slots=True, repr=False)
class Located(ResultBase):
    """What `locate` gives for robots that stand still: a position each, with its covariance."""

    given: SwarmInput
    settings: Settings
    network: BearingNetwork
    estimate: SwarmEstimate
    scored: StandingScore | None

    @property
    def score(self) -> SwarmScore | None:
        return None if self.scored is None else self.scored.score

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.given.warnings, *self.estimate.warnings)

    @property
    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        e = self.estimate
        return {
            **head(self.given, self.settings),
            **(NO_SCORE if self.score is None else self.score.as_json()),
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
        lines = [
            (
                f"{len(e.ids)} robots in {e.dim}D, {len(self.network.observer)} sightings, {sigma_text(self.given)}, "
                f"{len(self.given.anchors)} anchors, method {e.method}: {e.status} after {e.iterations} iterations"
            )
        ]
        lines += dropped_lines(self.given)
        if e.gauge:
            lines.append(f"without enough anchors the answer is the shape alone: {e.gauge}")
        if e.cov is not None:
            free = e.localisable & ~e.anchor
            if free.any():
                std = float(np.sqrt(np.trace(e.cov[free], axis1=1, axis2=2).mean()))
                unit = "" if "scale free" in e.gauge else " m"
                lines.append(f"estimated standard deviation of a position: {std:.4g}{unit} (rms)")
        lost = e.not_localisable
        if lost:
            lines.append(
                f"{len(lost)} robots cannot be located: {', '.join(lost[:20])}{', ..' if len(lost) > 20 else ''}"
            )
        lines.append(
            f"chi-square {e.chi2:.4g} with {e.dof} degrees of freedom, {int(e.outlier.sum())} outliers: "
            f"{'reliable' if e.reliable else 'NOT reliable'}"
        )
        if e.traffic:
            lines.append(
                f"{e.traffic.rounds} rounds, {e.traffic.messages} messages, {e.traffic.bytes} bytes between robots"
            )
        if self.score is not None:
            lines += self.score.lines()
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def draw(self, target: Target) -> None:
        """The robots in the plane."""
        network_figure(target, self.network, self.estimate, self.story().truth)

    def write_into(self, out: Path) -> None:
        """positions.csv, network.npz, metrics.json, report.html, figures/ and, for stamped sightings, trajectories/."""
        self.write_data(out)
        write_network_report(out, self.story(), self.lines(), self.metrics)

    def write_data(self, out: Path) -> None:
        e = self.estimate
        seen, wild = self.counts()
        write_positions(
            out / "positions.csv", e.ids, e.position, e.cov, e.localisable, seen, wild, e.heading, e.heading_var
        )
        scored = standing_swarm(self.network, e)
        write_network(out / "network.npz", scored.pairs, scored.information)
        t = self.given.table.t
        if t is not None:
            files = track_files(e.ids)
            for k, name in enumerate(e.ids):
                rows = (self.given.table.observer == k) | (self.given.table.target == k)
                at = np.unique(t[rows])
                place = np.tile(e.position[k], (len(at), 1))
                cov = None if e.cov is None else np.tile(e.cov[k], (len(at), 1, 1))
                write_track(out / "trajectories" / files[name], at, place, cov)
        write_rest(out, self.given, self.metrics)

    def counts(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Sightings each robot has a part in, and how many of them are outliers."""
        return counts(len(self.estimate.ids), self.network.observer, self.network.target, self.estimate.outlier)

    def story(self) -> NetworkStory:
        scored = self.scored
        return NetworkStory(
            self.network,
            self.estimate,
            None if scored is None else scored.truth,
            None if scored is None else scored.aligned,
        )


def standing_swarm(net: BearingNetwork, estimate: SwarmEstimate) -> StandingSwarm:
    """What is scored of `estimate`; the joint information stands where it says what the covariances say."""
    pairs = np.column_stack([net.observer, net.target])
    honest = estimate.cov is not None and not estimate.gauge and np.any(net.sigma > 0)
    joint = estimate.information if honest else None
    return StandingSwarm(
        estimate.ids,
        estimate.position,
        estimate.cov,
        estimate.localisable,
        estimate.anchor,
        estimate.gauge,
        pairs,
        joint,
        float(np.median(net.sigma)),
    )
