"""Merging where nobody says which landmark is which: how often the right pairs are found, and when it is refused."""

from dataclasses import dataclass

import numpy as np

from ...core import se2
from ...core.workers import Progress, no_progress
from ...fusion.alignment import joint_fit, log_correspondences, log_evidence, spread_area
from ...fusion.identities import IDENTITY_CHANCE, IdentityConfig, match_maps
from ...landmarks.landmark_map import LandmarkMap

POINTS, SIZE, SIGMA = 20, 3.0, 0.01  # landmarks a map, side of the square [m], deviation [m]
RIGHT = 0.15  # [m] every landmark must lie within, for an alignment to be right
IN_COMMON = (0, 2, 4, 6, 8, 14)
EXACT = IdentityConfig(noise=0.0, scale_sigma=1e-3, gate=3.5)  # maps that err as their covariances say, and no more


@dataclass(frozen=True, slots=True)
class IdentityTrials:
    """Of `trials` pairs of maps with `common` landmarks in both.

    aligned: the alignment was right, believed or not; right, wrong: believed and so; refused: not believed, mostly for
    `reason`. exact: whether matching knew that covariances and scales are right, or took both for those of real maps.
    """

    exact: bool
    common: int
    trials: int
    aligned: int
    right: int
    wrong: int
    refused: int
    reason: str
    evidence_right: tuple[float, ...] = ()
    evidence_wrong: tuple[float, ...] = ()
    evidence_true: tuple[float, ...] = ()  # of the true links, of all trials with more than two in common


@dataclass(frozen=True, slots=True)
class Price:
    """What believing a share of the right alignments costs: the odds needed, and wrong ones believed of how many."""

    odds: float
    wrong: int
    of: int


def price(rows: tuple[IdentityTrials, ...], common: int, share: float) -> Price | None:
    """The price of believing `share` of the trials with `common` in common; None where no odds reach it.

    Wrong ones are counted over all of `rows`, which are of one kind of matching.
    """
    asked = next(t for t in rows if t.common == common)
    needed = int(np.ceil(share * asked.trials))
    if len(asked.evidence_right) < needed:
        return None
    least = sorted(asked.evidence_right, reverse=True)[needed - 1]
    wrong = sum(e >= least for t in rows for e in t.evidence_wrong)
    return Price(float(np.exp(least)), wrong, sum(t.trials for t in rows))


def most_without_wrong(rows: tuple[IdentityTrials, ...], common: int) -> tuple[float, int]:
    """Odds of the strongest wrong match of all `rows`, and how many right ones with `common` in common are stronger."""
    strongest = max((e for t in rows for e in t.evidence_wrong), default=-np.inf)
    asked = next(t for t in rows if t.common == common)
    return float(np.exp(strongest)), sum(e > strongest for e in asked.evidence_right)


def oracle(rows: tuple[IdentityTrials, ...], common: int, odds: float = IDENTITY_CHANCE) -> int:
    """In how many trials even the true links, all of them and no other, have odds against chance of `odds` or more.

    No test that believes at these odds believes more of them: more evidence than the true links is evidence for others.
    """
    asked = next(t for t in rows if t.common == common)
    return sum(bool(e >= np.log(odds)) for e in asked.evidence_true)


def true_evidence(
    source: LandmarkMap, target: LandmarkMap, T: np.ndarray, links: set[tuple[int, int]], cfg: IdentityConfig
) -> float:
    """Logarithm of the odds for the true links against chance, T the true alignment."""
    true = np.array(sorted(links), dtype=np.intp)
    fit = joint_fit(source, target, true, T, cfg.noise, cfg.scale_sigma)
    area = min(spread_area(source), spread_area(target))
    known = log_evidence(source, target, true, fit, area, cfg.noise, cfg.scale_sigma)
    return known - log_correspondences(len(true), len(source), len(target))


def price_text(rows: tuple[IdentityTrials, ...]) -> str:
    """What believing 98 of 100 with six in common costs, and the most at no cost, in words that end a sentence."""
    asked = next(t for t in rows if t.common == 6)
    odds, most = most_without_wrong(rows, 6)
    where = f"beyond odds of {odds:.2g}" if odds > 0 else "at any odds"
    bound = f"{where} none of these pairs is matched wrongly, and {most} of {asked.trials} rightly"
    cost = price(rows, 6, 0.98)
    if cost is None:
        none = asked.trials - len(asked.evidence_right)
        why = f"is beyond any odds: in {none} of {asked.trials} trials fewer than six fit, or others as well"
    else:
        why = f"odds of {cost.odds:.2g} would have to do, at which {cost.wrong} of {cost.of} pairs are believed wrongly"
    return f"{why}; {bound}"


def identities_text(rows: tuple[IdentityTrials, ...]) -> str:
    """How many are believed of 98 of 100 asked for, with six in common; what else is so, and what more would cost."""
    six = next(t for t in rows if t.common == 6)
    share = "reached" if six.right >= 0.98 * six.trials else "missed"
    return (
        f"98 of 100 {share}: {six.right} of {six.trials} believed and right with six in common, where the true links "
        f"have such odds in {oracle(rows, 6)}; the alignment is right in {six.aligned}, refused ones counted; of all "
        f"rows {sum(t.wrong for t in rows)} wrongly believed; for it to believe 98 {price_text(rows)}"
    )


def draw_pair(
    common: int, rng: np.random.Generator
) -> tuple[LandmarkMap, LandmarkMap, np.ndarray, set[tuple[int, int]]]:
    """Two maps with `common` landmarks in both, `T_target_source`, and the true links (source, target)."""
    points = rng.uniform(0, SIZE, (2 * POINTS - common, 2))
    order = rng.permutation(POINTS)
    T = np.append(rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi))
    first = points[:POINTS] + rng.normal(0, SIGMA, (POINTS, 2))
    second = se2.act(T, points[POINTS - common :][order]) + rng.normal(0, SIGMA, (POINTS, 2))
    names = tuple(str(i) for i in range(POINTS))
    P = SIGMA**2 * np.eye(2 * POINTS)
    place = np.argsort(order)
    links = {(POINTS - common + i, int(place[i])) for i in range(common)}
    return LandmarkMap(names, first, P), LandmarkMap(names, second, P), T, links


def identity_trials(
    trials: int,
    seed: int,
    commons: tuple[int, ...] = IN_COMMON,
    *,
    exact: bool = True,
    on_progress: Progress = no_progress,
) -> tuple[IdentityTrials, ...]:
    """`trials` pairs for every number in common, every pair with a generator of its own."""
    out = []
    cfg = EXACT if exact else IdentityConfig()
    for at, common in enumerate(commons):
        on_progress("identities", at, len(commons))
        aligned = right = wrong = 0
        reasons: dict[str, int] = {}
        evidence: dict[bool, list[float]] = {True: [], False: []}
        true: list[float] = []
        for trial in range(trials):
            source, target, T, links = draw_pair(common, np.random.default_rng([seed, common, trial]))
            match = match_maps(source, target, cfg)
            off = se2.act(match.T_target_source, source.mean) - se2.act(T, source.mean)
            ok = bool(np.hypot(off[:, 0], off[:, 1]).max() < RIGHT)
            aligned += ok
            true += [true_evidence(source, target, T, links, EXACT)] if common > 2 else []
            right += match.accepted and ok
            wrong += match.accepted and not ok
            kind = "" if match.accepted else _kind(match.reason)
            if kind in {"", "chance"}:
                evidence[ok].append(match.evidence)
            if kind:
                reasons[kind] = reasons.get(kind, 0) + 1
        most = max(reasons, key=lambda kind: reasons[kind]) if reasons else ""
        refused = trials - right - wrong
        scores = tuple(evidence[True]), tuple(evidence[False]), tuple(true)
        out.append(IdentityTrials(exact, common, trials, aligned, right, wrong, refused, most, *scores))
    return tuple(out)


def _kind(reason: str) -> str:
    """The reason without its numbers."""
    for kind in ("another alignment", "chi-square", "chance", "needed"):
        if kind in reason:
            return {"needed": "too few agree"}.get(kind, kind)
    return reason
