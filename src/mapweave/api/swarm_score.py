"""A located swarm against its truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..evaluation.swarm import PaperErrors, paper_errors, rms, similarity
from ..io.sightings import SwarmTruth
from ..swarm.config import SwarmConfig
from ..swarm.locate import locate as estimate
from ..swarm.moving.result import SwarmTrack
from ..swarm.network import Network
from ..swarm.result import SwarmEstimate


@dataclass(frozen=True, slots=True)
class SwarmScore:
    """Errors [m] over free, localisable robots that have a truth.

    alignment: what was fitted to the truth first, "none" with anchors; aligned: (n, d) estimates as scored;
    truth: (n, d), NaN where there is none; errors: as the paper defines them, of the aligned positions.
    """

    rmse: float | None
    crlb_rmse: float | None
    nees_per_dof: float | None
    alignment: str
    scored: int
    without_truth: int
    errors: PaperErrors | None
    aligned: Float[np.ndarray, "n d"]
    truth: Float[np.ndarray, "n d"]

    @property
    def rmse_over_crlb(self) -> float | None:
        return self.rmse / self.crlb_rmse if self.rmse is not None and self.crlb_rmse else None

    def as_json(self) -> dict[str, Any]:
        return {
            "rmse": self.rmse,
            "crlb_rmse": self.crlb_rmse,
            "rmse_over_crlb": self.rmse_over_crlb,
            "nees_per_dof": self.nees_per_dof,
            "distance_error": self.errors.distance if self.errors else None,
            "angle_error_deg": self.errors.angle_deg if self.errors else None,
            "alignment": self.alignment,
            "robots_scored": self.scored,
            "robots_without_truth": self.without_truth,
        }

    def lines(self) -> list[str]:
        ratio = "" if self.rmse_over_crlb is None else f" ({self.rmse_over_crlb:.3f} of the Cramer-Rao bound)"
        told = [f"RMSE {_say(self.rmse)} m{ratio}, NEES per degree of freedom {_say(self.nees_per_dof)}"]
        if self.errors:
            told.append(f"distance error {self.errors.distance:.4g} m, angle error {self.errors.angle_deg:.4g} deg")
        if self.alignment != "none":
            told.append(f"scored after fitting {self.alignment} to the truth")
        return told


def places_of(truth: SwarmTruth, ids: Sequence[str], dim: int) -> Float[np.ndarray, "n d"]:
    """The (first) true place of every robot, NaN where there is none."""
    out = np.full((len(ids), dim), np.nan)
    where = {name: k for k, name in enumerate(ids)}
    d = min(dim, truth.position.shape[1])
    for name, p in reversed(list(zip(truth.ids, truth.position, strict=True))):
        if name in where:
            out[where[name], :d] = p[:d]
    return out


def score_estimate(net: Network, found: SwarmEstimate, truth: SwarmTruth, *, bound: bool) -> SwarmScore:
    """`found` against `truth`; `bound`: also the Cramer-Rao bound at the truth (as much work as the covariances)."""
    places = places_of(truth, net.ids, net.dim)
    have = np.isfinite(places).all(axis=1)
    use = have & found.localisable & ~found.anchor
    aligned, alignment = found.position, "none"
    fit = have & found.localisable
    if found.gauge and fit.sum() >= 2:
        aligned, alignment = fitted(found.position, places, fit, found.gauge)
    whole = bool(have[found.localisable].all())
    nees = None
    if not found.gauge and use.any():
        if whole and found.information is not None:
            value, dof = found.nees(np.where(have[:, None], places, 0.0))
            nees = value / dof if dof else None
        elif found.cov is not None:
            nees = marginal_nees(found.position[use] - places[use], found.cov[use])
    crlb = None
    if bound and not found.gauge and whole and use.any() and np.any(net.sigma > 0):
        start = np.where(have[:, None], places, found.position)
        at_truth = estimate(net, SwarmConfig(max_iterations=0), start)
        if at_truth.cov is not None:
            crlb = float(np.sqrt(np.trace(at_truth.cov[use], axis1=1, axis2=2).mean()))
    return SwarmScore(
        rmse=rms(aligned[use] - places[use]),
        crlb_rmse=crlb,
        nees_per_dof=nees,
        alignment=alignment,
        scored=int(use.sum()),
        without_truth=int((~have).sum()),
        errors=_paper(net, aligned, places, fit) if use.any() else None,
        aligned=np.asarray(aligned),
        truth=places,
    )


def fitted(
    position: Float[np.ndarray, "n d"], truth: Float[np.ndarray, "n d"], fit: Bool[np.ndarray, " n"], gauge: str
) -> tuple[Float[np.ndarray, "n d"], str]:
    """`position` carried onto `truth` at the robots `fit` by what `gauge` says is free, and which parts that are.

    Place is always fitted, also where one anchor holds it.
    """
    scale, turn = "scale free" in gauge, "orientation free" in gauge
    s, R, t = similarity(position[fit], truth[fit], scale=scale, turn=turn)
    parts = ["place", *(["scale"] if scale else []), *(["turn"] if turn else [])]
    return np.asarray(s * position @ R.T + t), " and ".join(parts)


def marginal_nees(error: Float[np.ndarray, "k d"], cov: Float[np.ndarray, "k d d"]) -> float | None:
    """Mean of `e^T P^-1 e` a degree of freedom, each row with its own covariance; None when one is singular."""
    try:
        return float(
            np.einsum("ka,ka->k", error, np.linalg.solve(cov, error[..., None])[..., 0]).mean() / error.shape[1]
        )
    except np.linalg.LinAlgError:
        return None


def score_track(
    track: SwarmTrack, ids: Sequence[str], anchors: Sequence[int], truth: SwarmTruth
) -> tuple[SwarmScore, dict[int, Float[np.ndarray, "k d"]]]:
    """All positions over time of robots that are no anchors; also the true positions at each robot's stamps,
    in the frame of the track.
    """
    there = _over_time(track, ids, truth)
    free = [k for k in there if k not in set(anchors)]
    found = {k: track.tracks[k].position for k in free}
    alignment, there_in_frame = "none", there
    if track.gauge and free:
        p, q = np.concatenate([found[k] for k in free]), np.concatenate([there[k] for k in free])
        have = np.isfinite(q).all(axis=1)
        s, R, t = similarity(p[have], q[have], scale=False, turn=True)
        found = {k: s * p @ R.T + t for k, p in found.items()}
        there_in_frame = {k: (q - t) @ R / s for k, q in there.items()}
        alignment = "place and turn"
    dim = next(iter(track.tracks.values())).position.shape[1]
    error = np.concatenate([found[k] - there[k] for k in free]) if free else np.zeros((0, dim))
    have = np.isfinite(error).all(axis=1)
    nees = None
    cov = [track.tracks[k].cov for k in free]
    if not track.gauge and free and all(c is not None for c in cov):
        nees = marginal_nees(error[have], np.concatenate([c for c in cov if c is not None])[have])
    last = np.full((len(ids), dim), np.nan)
    score = SwarmScore(
        rms(error[have]), None, nees, alignment, len(free), len(track.tracks) - len(there), None, last, last
    )
    return score, there_in_frame


def over_time(
    t: Float[np.ndarray, " k"], stamps: Float[np.ndarray, " n"], place: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "k d"]:
    """The place at `t`, straight between `stamps`, NaN before the first and after the last."""
    at = [np.interp(t, stamps, column, left=np.nan, right=np.nan) for column in place.T]
    return np.column_stack(at)


def _over_time(track: SwarmTrack, ids: Sequence[str], truth: SwarmTruth) -> dict[int, Float[np.ndarray, "k d"]]:
    names = np.array(truth.ids)
    out = {}
    for k, one in track.tracks.items():
        rows = np.flatnonzero(names == ids[k])
        if not len(rows):
            continue
        d = one.position.shape[1]
        if truth.t is None:
            out[k] = np.broadcast_to(truth.position[rows[0], :d], one.position.shape)
            continue
        rows = rows[np.argsort(truth.t[rows], kind="stable")]
        out[k] = over_time(one.t, truth.t[rows], truth.position[rows, :d])
    return out


def _paper(
    net: Network, aligned: Float[np.ndarray, "n d"], places: Float[np.ndarray, "n d"], fit: np.ndarray
) -> PaperErrors | None:
    if fit.sum() < 3:
        return None
    rank = np.full(len(fit), -1)
    rank[fit] = np.arange(int(fit.sum()))
    pairs = np.column_stack([rank[net.observer], rank[net.target]])
    return paper_errors(aligned[fit], places[fit], pairs[(pairs >= 0).all(axis=1)])


def _say(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
