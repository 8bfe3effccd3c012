"""Whether two maps show the same place: how much better "equal names are one landmark" explains them than chance.

Names alone prove nothing: two rooms may use the same ones. Compared are two statements about the n landmarks that two
maps both name. Same place: up to one rigid transform and a scale near 1 they lie where the covariances say, but for a
few wrong names. Different places: the second map's lie anywhere in it. The ratio of the probability densities of what
was measured (the Bayes factor) grows with every landmark that agrees, and the more so the surer both maps are; two or
three that agree by luck leave it small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.names import in_order
from ..landmarks.landmark_map import LandmarkMap
from .alignment import align_robust, joint_fit
from .config import FuseConfig
from .evidence import log_evidence, spread_area

ENOUGH = 2  # landmarks in common that fix a rigid transform
LISTED = 8  # contradicting landmarks told by name


@dataclass(frozen=True, slots=True)
class Evidence:
    """log_odds: natural logarithm of the Bayes factor for the same place; shared: names both maps have.

    contradicting: those that lie further apart than `FuseConfig.gate` under the alignment most agree on, the furthest
    first, and `distance`: how far [m].
    """

    log_odds: float
    shared: tuple[str, ...]
    contradicting: tuple[str, ...]
    distance: tuple[float, ...]

    def reason(self, other: str) -> str:
        """Why this is not enough to join `other`, in plain words."""
        n, wrong = len(self.shared), len(self.contradicting)
        if not wrong:
            named = ", ".join(self.shared[:LISTED])
            return f"that the {n} landmarks it shares with {other} ({named}{_more(n)}) agree may be chance"
        named = ", ".join(sorted(self.contradicting[:LISTED], key=in_order))
        lie = "lies" if wrong == 1 else "lie"
        far = f"{self.distance[-1]:.2f} to {self.distance[0]:.2f}" if wrong > 1 else f"{self.distance[0]:.2f}"
        return (
            f"contradicts {other}: {n - wrong} of {n} shared landmarks agree; {named}{_more(wrong)} {lie} {far} m "
            "from where the others put them"
        )


def _more(n: int) -> str:
    return f" and {n - LISTED} more" if n > LISTED else ""


def same_place(source: LandmarkMap, target: LandmarkMap, cfg: FuseConfig) -> Evidence:
    """The evidence that the landmarks which both maps name (two at least) are the same ones.

    Both covariances are multiplied by `cfg.distrust` first: filters are too sure of themselves.
    """
    there = set(target.ids)
    shared = tuple(name for name in source.ids if name in there)
    weighed = shared
    if len(shared) > cfg.weighed:
        weighed = tuple(shared[i] for i in np.linspace(0, len(shared) - 1, cfg.weighed).round().astype(np.intp))
    a, b = _distrusted(source.select(weighed), cfg), _distrusted(target.select(weighed), cfg)
    rough = align_robust(a.mean, b.mean, np.full(len(weighed), cfg.gate))
    apart = np.hypot(*(se2.act(rough.T_target_source, a.mean) - b.mean).T)
    far = [int(i) for i in np.argsort(-apart, kind="stable") if apart[i] > cfg.gate]
    area = max(min(spread_area(source), spread_area(target)), 1e-12)
    return Evidence(
        log_odds=_log_odds(a, b, rough.T_target_source, area, cfg),
        shared=shared,
        contradicting=tuple(weighed[i] for i in far),
        distance=tuple(float(apart[i]) for i in far),
    )


@dataclass(slots=True)
class PlaceTest:
    """Which of `maps` may be joined; robots[k] drove map k, recordings[k] names the recording it is made from.

    Maps of one recording share a table of names, so that little evidence does; names of two recordings may have
    nothing to do with each other. Every pair is worked out once.
    """

    maps: Sequence[LandmarkMap]
    robots: Sequence[str]
    recordings: Sequence[str]
    cfg: FuseConfig
    _known: dict[tuple[int, int], Evidence] = field(init=False, default_factory=dict)

    def evidence(self, i: int, k: int) -> Evidence:
        """For maps i and k, which share two names at least, showing the same place; either order gives the same."""
        pair = (min(i, k), max(i, k))
        if pair not in self._known:
            self._known[pair] = same_place(self.maps[pair[1]], self.maps[pair[0]], self.cfg)
        return self._known[pair]

    def joins(self, i: int, k: int) -> bool:
        """Whether maps i and k show the same place."""
        return self.evidence(i, k).log_odds >= self.needed([i, k])

    def needed(self, members: Sequence[int]) -> float:
        """The log-odds from which these maps are one place."""
        one = len({self.recordings[k] for k in members}) == 1
        return float(np.log(self.cfg.odds_within if one else self.cfg.odds))


def _distrusted(m: LandmarkMap, cfg: FuseConfig) -> LandmarkMap:
    return LandmarkMap(m.ids, m.mean, cfg.distrust * m.cov, m.frame)


def _log_odds(a: LandmarkMap, b: LandmarkMap, T: Float[np.ndarray, "3"], area: float, cfg: FuseConfig) -> float:
    """The log Bayes factor of landmark i of `a` being landmark i of `b`; -inf where under half of them can be.

    The transform, uniform over the area and all headings, and the scale are integrated over (Laplace's method).
    """
    n = len(a)
    links = np.stack([np.arange(n)] * 2, axis=1)
    fit = joint_fit(a, b, links, T, cfg.floor, cfg.scale_sigma)
    while len(links) > ENOUGH and fit.single.max() > cfg.mislabelled_chi2:
        if 2 * (len(links) - 1) < n:
            return -np.inf
        links = np.delete(links, int(np.argmax(fit.single)), axis=0)
        fit = joint_fit(a, b, links, fit.T, cfg.floor, cfg.scale_sigma)
    k = len(links)
    names = k * np.log1p(-cfg.mislabelled) + (n - k) * np.log(cfg.mislabelled)
    return log_evidence(a, b, links, fit, area, cfg.floor, cfg.scale_sigma) + float(names)
