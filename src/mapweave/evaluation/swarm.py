"""How far a located swarm is from the truth, and whether its covariances say so: one scoring, standing or moving.

`nees_per_dof` of robots that stand is `e^T P^-1 e` over all of them jointly, by its degrees of freedom: each direction
of the error counts once, and an honest estimate gives a chi-square variable. The mean over robots of `e^T P^-1 e` with
each robot's own covariance expects 1 too, but robots share most of their error (the scale between far anchors), so on
one swarm that mean is a draw from a few degrees of freedom whatever the number of robots. It stands in where no joint
information is known: for positions over time.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..io.sightings import SwarmTruth
from ..swarm.moving.result import RobotTrajectory
from ..swarm.result import JointInformation
from .consistency import MEASURED, STANDING, another_order_fits, beyond, by_chance, few_known, some, spread_of

SMALL = 40  # robots up to which all pairs and all triangles count
Points = Float[np.ndarray, "n d"]


@dataclass(frozen=True, slots=True)
class PaperErrors:
    """[Hamatani] section 3.2: mean errors of distances between robots [m] and of inner angles of triangles [deg]."""

    distance: float
    angle_deg: float


def paper_errors(estimate: Points, truth: Points, pairs: Int[np.ndarray, "p 2"]) -> PaperErrors | None:
    """The paper's errors, as it defines them: no alignment.

    Up to `SMALL` robots over all pairs and triangles; beyond over `pairs` (who sees whom) and the angles at an observer
    between two robots it sees one after the other. None when there is no triangle.
    """
    n = len(estimate)
    if n < 3:
        return None
    if n <= SMALL:
        sides = np.array(list(combinations(range(n), 2)))
        triples = np.array([p for a, b, c in combinations(range(n), 3) for p in ((a, b, c), (b, c, a), (c, a, b))])
    else:
        sides = np.unique(np.sort(pairs, axis=1), axis=0)
        triples = _seen(pairs)
    if not len(triples):
        return None
    distance = np.abs(_distance(estimate, sides) - _distance(truth, sides))
    angle = np.abs(_angle(estimate, triples) - _angle(truth, triples))
    return PaperErrors(float(distance.mean()), float(np.degrees(angle.mean())))


def seen_angle_error(estimate: Points, truth: Points, pairs: Int[np.ndarray, "p 2"]) -> float | None:
    """Median error of the angles at an observer between two robots it sees [rad]; None where nobody sees two."""
    triples = _seen(pairs)
    error = np.abs(_angle(estimate, triples) - _angle(truth, triples))
    return float(np.median(error)) if len(error) else None


def _seen(pairs: Int[np.ndarray, "p 2"]) -> Int[np.ndarray, "q 3"]:
    """Of `pairs` of observer and seen: an observer and two that it sees, one after the other."""
    order = np.unique(pairs, axis=0)
    same = order[1:, 0] == order[:-1, 0]
    return np.asarray(np.column_stack([order[1:, 0], order[:-1, 1], order[1:, 1]])[same])


def similarity(source: Points, target: Points, *, scale: bool, turn: bool) -> tuple[float, np.ndarray, np.ndarray]:
    """s, R, t of least squares with `target = s R source + t`; what is not asked for stays 1 or the identity."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    R = np.eye(source.shape[1])
    if turn:
        U, _, Vt = np.linalg.svd(b.T @ a)
        D = np.ones(source.shape[1])
        D[-1] = np.sign(np.linalg.det(U @ Vt)) or 1.0
        R = (U * D) @ Vt
    s = 1.0
    size = float(np.sum(a * a))
    if scale and size > 0.0:
        s = float(np.sum(b * (a @ R.T))) / size
    return s, R, target.mean(axis=0) - s * R @ source.mean(axis=0)


def _distance(p: Points, pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, " p"]:
    return np.asarray(np.linalg.norm(p[pairs[:, 1]] - p[pairs[:, 0]], axis=1))


def _angle(p: Points, triples: Int[np.ndarray, "q 3"]) -> Float[np.ndarray, " q"]:
    """The angle at the first robot of each triple between the other two [rad]."""
    a, b = p[triples[:, 1]] - p[triples[:, 0]], p[triples[:, 2]] - p[triples[:, 0]]
    dot = np.sum(a * b, axis=1)
    across = np.sqrt(np.maximum(np.sum(a * a, axis=1) * np.sum(b * b, axis=1) - dot * dot, 0.0))
    return np.asarray(np.arctan2(across, dot))


FEW, STAMPS = 12, 40  # robots that move and their stamps that say whether a truth belongs


@dataclass(frozen=True, slots=True)
class SwarmScore:
    """Errors [m] over free, localisable robots that have a truth.

    alignment: what was fitted to the truth first, "none" with anchors; errors: as the paper defines them, of robots
    that stand, after the alignment; crlb_rmse: the Cramer-Rao bound at the truth, where it was asked for; doubts: why
    the truth may be of another recording.
    """

    rmse: float | None
    nees_per_dof: float | None
    alignment: str
    scored: int
    without_truth: int
    errors: PaperErrors | None = None
    crlb_rmse: float | None = None
    doubts: tuple[str, ...] = ()

    @property
    def rmse_over_crlb(self) -> float | None:
        return self.rmse / self.crlb_rmse if self.rmse is not None and self.crlb_rmse else None

    def as_json(self) -> dict[str, Any]:
        """The keys that `metrics.json` of `locate` and `evaluate --json` share."""
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
            **({"warnings": list(self.doubts)} if self.doubts else {}),
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        ratio = "" if self.rmse_over_crlb is None else f" ({self.rmse_over_crlb:.3f} of the Cramer-Rao bound)"
        error = f"RMSE {_text(self.rmse)} m{ratio} over {self.scored} robots"
        lines = [f"{error}, NEES per degree of freedom {_text(self.nees_per_dof)}"]
        if self.errors:
            lines.append(f"distance error {self.errors.distance:.4g} m, angle error {self.errors.angle_deg:.4g} deg")
        if self.alignment != "none":
            lines.append(f"scored after fitting {self.alignment} to the truth")
        if self.without_truth:
            lines.append(f"{self.without_truth} robots have no truth and are left out")
        return [*lines, *(f"warning: {doubt}" for doubt in self.doubts)]


@dataclass(frozen=True, slots=True)
class StandingSwarm:
    """What is scored of n robots that stand still.

    cov: (n, d, d), NaN where unknown, or None; pairs: (m, 2) who sighted whom; information: of all robots jointly,
    None where a gauge is free or covariances were left out; sigma: the usual deviation of a bearing [rad], if known.
    """

    ids: Sequence[str]
    position: Float[np.ndarray, "n d"]
    cov: Float[np.ndarray, "n d d"] | None
    localisable: Bool[np.ndarray, " n"]
    anchor: Bool[np.ndarray, " n"]
    gauge: str
    pairs: Int[np.ndarray, "m 2"]
    information: JointInformation | None = None
    sigma: float | None = None


@dataclass(frozen=True, slots=True)
class StandingScore:
    """aligned: (n, d) estimates as scored; truth: (n, d), NaN where there is none."""

    score: SwarmScore
    aligned: Float[np.ndarray, "n d"]
    truth: Float[np.ndarray, "n d"]


def score_standing(swarm: StandingSwarm, truth: SwarmTruth, crlb_rmse: float | None = None) -> StandingScore:
    """`swarm` against the (first) true place of every robot."""
    places = true_places(truth, swarm.ids, swarm.position.shape[1])
    have = np.isfinite(places).all(axis=1)
    use, fit = scored_robots(swarm, places), have & swarm.localisable
    aligned, alignment = swarm.position, "none"
    if swarm.gauge and fit.sum() >= 2:
        aligned, alignment = _fitted(swarm.position, places, fit, swarm.gauge)
    nees = None
    if not swarm.gauge and use.any():
        if swarm.information is not None:
            value, dof = swarm.information.nees(swarm.position - places, use)
            nees = value / dof if dof else None
        elif swarm.cov is not None and np.isfinite(swarm.cov[use]).all():
            nees = marginal_nees(swarm.position[use] - places[use], swarm.cov[use])
    score = SwarmScore(
        rmse=rms(aligned[use] - places[use]),
        nees_per_dof=nees,
        alignment=alignment,
        scored=int(use.sum()),
        without_truth=int((~have).sum()),
        errors=_shape_errors(swarm.pairs, aligned, places, fit) if use.any() else None,
        crlb_rmse=crlb_rmse,
        doubts=_doubts_standing(swarm, truth, places, fit, nees),
    )
    return StandingScore(score, np.asarray(aligned), places)


def scored_robots(swarm: StandingSwarm, places: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
    """(n,) which robots count: localisable, no anchors, and with a truth."""
    return np.asarray(np.isfinite(places).all(axis=1) & swarm.localisable & ~swarm.anchor)


def _doubts_standing(
    swarm: StandingSwarm,
    truth: SwarmTruth,
    places: Float[np.ndarray, "n d"],
    fit: Bool[np.ndarray, " n"],
    nees: float | None,
) -> tuple[str, ...]:
    """Why `truth` may be of another recording than the swarm."""
    both = np.flatnonzero(fit)
    both = both[some(len(both))]
    ours, true = swarm.position[both], places[both]

    def error(order: Int[np.ndarray, " k"]) -> float:
        there = true[order]
        if not swarm.gauge:
            return rms(ours - there) or 0.0
        return rms(_fitted(ours, there, np.ones(len(ours), bool), swarm.gauge)[0] - there) or 0.0

    spread = spread_of(true)
    chance = another_order_fits(len(both), error, spread)
    motion = _largest_motion(truth, swarm.ids)
    doubts = [
        few_known("robots", int(np.isfinite(places).all(axis=1).sum()), len(places)),
        by_chance("robots", len(both), error(np.arange(len(both)))) if chance else beyond(nees),
    ]
    if len(both) > 1 and motion > STANDING * spread:
        doubts.append(f"the truth's robots move by up to {motion:.3g} m, the result's stand: its first places count")
    off = seen_angle_error(swarm.position, places, swarm.pairs[fit[swarm.pairs].all(axis=1)])
    if off is not None and swarm.sigma and off > MEASURED * swarm.sigma and not chance:
        doubts.append(
            f"angles between robots that are seen are off by {np.degrees(off):.3g} deg where bearings are good to "
            f"{np.degrees(swarm.sigma):.2g} deg: the truth may be of another recording"
        )
    return tuple(filter(None, doubts))


def _largest_motion(truth: SwarmTruth, ids: Sequence[str]) -> float:
    """The greatest distance between two true places of one of the robots `ids` [m]: the diagonal of all its places."""
    known = np.isin(np.array(truth.ids), list(ids)) if truth.t is not None else np.zeros(len(truth.ids), bool)
    if not known.any():
        return 0.0
    names, which = np.unique(np.array(truth.ids)[known], return_inverse=True)
    low = np.full((len(names), truth.position.shape[1]), np.inf)
    high = -low
    np.minimum.at(low, which, truth.position[known])
    np.maximum.at(high, which, truth.position[known])
    return float(np.linalg.norm(high - low, axis=1).max())


def score_moving(
    tracks: Mapping[str, RobotTrajectory], left_out: Collection[str], gauge: str, truth: SwarmTruth
) -> tuple[SwarmScore, dict[str, Float[np.ndarray, "k d"]]]:
    """All positions over time of the robots not `left_out` (anchors, and robots that cannot be located).

    Also the true positions at each robot's stamps, in the frame of the tracks, of all robots that have a truth.
    """
    there = _true_tracks(tracks, truth)
    free = [name for name in there if name not in left_out]
    position = {name: tracks[name].position for name in free}
    alignment, in_frame = "none", there
    p, q = (np.concatenate([at[k] for k in free]) if free else np.zeros((0, 2)) for at in (position, there))
    have = np.isfinite(q).all(axis=1)
    if gauge and have.any():
        s, R, t = similarity(p[have], q[have], scale=False, turn=True)
        position = {name: s * p @ R.T + t for name, p in position.items()}
        in_frame = {name: (q - t) @ R / s for name, q in there.items()}
        alignment = "place and turn"
    error = np.concatenate([position[k] - there[k] for k in free]) if free else np.zeros((0, 2))
    have = np.isfinite(error).all(axis=1)
    nees = None
    cov = [one for k in free if (one := tracks[k].cov) is not None]
    if not gauge and free and len(cov) == len(free):
        nees = marginal_nees(error[have], np.concatenate(cov)[have])
    missing = sum(name not in there for name in tracks)
    doubts = _doubts_moving(tracks, free, gauge, truth) or ((doubt,) if (doubt := beyond(nees)) else ())
    return SwarmScore(rms(error[have]), nees, alignment, len(free), missing, doubts=doubts), in_frame


def _doubts_moving(
    tracks: Mapping[str, RobotTrajectory], free: Sequence[str], gauge: str, truth: SwarmTruth
) -> tuple[str, ...]:
    """Why `truth` may be of another recording: whoever's true trajectory, it fits as well."""
    names = [free[k] for k in some(len(free))[:: max(1, len(free) // FEW)]]
    thinned = {name: _thinned(tracks[name]) for name in names}
    ways = [_true_tracks(dict.fromkeys(names, thinned[name]), truth) for name in names]
    p = np.concatenate([thinned[name].position for name in names]) if names else np.zeros((0, 2))

    def error(order: Int[np.ndarray, " k"]) -> float:
        q = np.concatenate([way[names[k]] for way, k in zip(ways, order, strict=True)])
        have = np.isfinite(q).all(axis=1)
        if have.sum() < 2:
            return np.inf
        s, R, t = similarity(p[have], q[have], scale=False, turn=True) if gauge else (1.0, np.eye(p.shape[1]), 0.0)
        return rms(s * p[have] @ R.T + t - q[have]) or 0.0

    doubts = [few_known("robots", sum(name in truth.ids for name in tracks), len(tracks))]
    if len(names) > 2:
        own = error(np.arange(len(names)))
        places = np.concatenate([ways[k][name] for k, name in enumerate(names)])
        spread = spread_of(places[np.isfinite(places).all(axis=1)])
        if np.isfinite(own) and another_order_fits(len(names), error, spread):
            doubts.append(by_chance("robots", len(free), own))
    return tuple(filter(None, doubts))


def _thinned(one: RobotTrajectory) -> RobotTrajectory:
    """At most `STAMPS` of its places."""
    keep = np.unique(np.linspace(0, len(one.t) - 1, min(len(one.t), STAMPS)).astype(np.int64))
    return RobotTrajectory(one.t[keep], one.position[keep])


def true_places(truth: SwarmTruth, ids: Sequence[str], dim: int) -> Float[np.ndarray, "n d"]:
    """The (first) true place of every robot, NaN where there is none."""
    out = np.full((len(ids), dim), np.nan)
    where = {name: k for k, name in enumerate(ids)}
    d = min(dim, truth.position.shape[1])
    for name, p in reversed(list(zip(truth.ids, truth.position, strict=True))):
        if name in where:
            out[where[name], :d] = p[:d]
    return out


def rms(error: Float[np.ndarray, "n d"]) -> float | None:
    """Root of the mean squared length of the rows; None without rows."""
    return float(np.sqrt(np.mean(np.sum(error * error, axis=1)))) if len(error) else None


def squared_errors(error: Float[np.ndarray, "k d"], cov: Float[np.ndarray, "k d d"]) -> Float[np.ndarray, " k"]:
    """`e^T P^-1 e` of every row with its own covariance; raises numpy.linalg.LinAlgError when one is singular."""
    return np.asarray(np.einsum("ka,ka->k", error, np.linalg.solve(cov, error[..., None])[..., 0]))


def marginal_nees(error: Float[np.ndarray, "k d"], cov: Float[np.ndarray, "k d d"]) -> float | None:
    """Mean of `e^T P^-1 e` a degree of freedom, each row with its own covariance; None without rows, or singular."""
    try:
        return float(squared_errors(error, cov).mean() / error.shape[1]) if len(error) else None
    except np.linalg.LinAlgError:
        return None


def _fitted(
    position: Float[np.ndarray, "n d"], truth: Float[np.ndarray, "n d"], fit: Bool[np.ndarray, " n"], gauge: str
) -> tuple[Float[np.ndarray, "n d"], str]:
    """`position` carried onto `truth` at the robots `fit` by what `gauge` says is free, and which parts that are.

    Place is always fitted, also where one anchor holds it.
    """
    scale, turn = "scale free" in gauge, "orientation free" in gauge
    s, R, t = similarity(position[fit], truth[fit], scale=scale, turn=turn)
    parts = ["place", *(["scale"] if scale else []), *(["turn"] if turn else [])]
    return np.asarray(s * position @ R.T + t), " and ".join(parts)


def _shape_errors(
    pairs: Int[np.ndarray, "m 2"], aligned: Float[np.ndarray, "n d"], places: Float[np.ndarray, "n d"], fit: np.ndarray
) -> PaperErrors | None:
    if fit.sum() < 3:
        return None
    rank = np.full(len(fit), -1)
    rank[fit] = np.arange(int(fit.sum()))
    among = rank[pairs]
    return paper_errors(aligned[fit], places[fit], among[(among >= 0).all(axis=1)])


def _true_tracks(tracks: Mapping[str, RobotTrajectory], truth: SwarmTruth) -> dict[str, Float[np.ndarray, "k d"]]:
    """By robot, the true place at its stamps: straight between the truth's, NaN before the first and after the last."""
    names = np.array(truth.ids)
    out = {}
    for name, one in tracks.items():
        rows = np.flatnonzero(names == name)
        d = one.position.shape[1]
        if not len(rows) or truth.position.shape[1] < d:
            continue
        if truth.t is None:
            out[name] = np.tile(truth.position[rows[0], :d], (len(one.t), 1))
            continue
        rows = rows[np.argsort(truth.t[rows], kind="stable")]
        columns = truth.position[rows, :d].T
        out[name] = np.column_stack(
            [np.interp(one.t, truth.t[rows], column, left=np.nan, right=np.nan) for column in columns]
        )
    return out


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
