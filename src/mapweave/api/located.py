"""What `locate` found of robots that stand still: for programs, for files and for people."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from ..evaluation.swarm import StandingScore, StandingSwarm, SwarmScore
from ..io.positions import track_files, write_network, write_positions, write_track
from ..report.result import ResultBase
from ..report.style import Target
from ..report.swarm import NetworkStory, write_network_report
from ..report.swarm_figures import network_figure
from ..swarm.network import Network
from ..swarm.result import SwarmEstimate
from .located_common import NO_SCORE, Settings, counts, dropped_lines, head, sigma_text, write_rest
from .swarm_input import SwarmInput


@dataclass(frozen=True, slots=True, repr=False)
class Located(ResultBase):
    """Robots that stand still: one position each."""

    given: SwarmInput
    settings: Settings
    network: Network
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
        write_network_report(out, self.story(), self.lines(), self.metrics)
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


def standing_swarm(net: Network, estimate: SwarmEstimate) -> StandingSwarm:
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
    )
