"""Whether an answer may be trusted, in plain words."""

import numpy as np

from ..core.gaussian import chi2_quantile
from .config import VERDICT, VerdictConfig
from .headings import mutual_pairs
from .network import BearingNetwork


def trust_warnings(net: BearingNetwork, outlier: np.ndarray, cfg: VerdictConfig = VERDICT) -> list[str]:
    """What stands against trusting which sightings were called wrong."""
    beyond = share_warnings(outlier, cfg)
    if beyond:
        return beyond
    share = float(outlier.mean())
    share_text = f"{100 * share:.0f} % of the sightings were called wrong"
    single = 2 * len(mutual_pairs(net)[0]) < 0.5 * len(net.observer)
    if share > cfg.many and single:
        return [f"{share_text}; where robots are not sighted from both ends the rest cannot be told from them"]
    return []


def share_warnings(outlier: np.ndarray, cfg: VerdictConfig = VERDICT) -> list[str]:
    """What stands against telling wrong sightings from right ones where so many are called wrong."""
    share = float(outlier.mean()) if len(outlier) else 0.0
    if share <= cfg.too_many:
        return []
    return [f"{100 * share:.0f} % of the sightings were called wrong: too many to say which ones"]


def fallen_warnings(net: BearingNetwork, rows: np.ndarray) -> list[str]:
    """What stands against sightings `rows` that agree only while two robots stand close together."""
    if not len(rows):
        return []
    pairs = [f"{net.ids[net.observer[k]]}-{net.ids[net.target[k]]}" for k in rows[:10].tolist()]
    named = ", ".join(pairs) + (", .." if len(rows) > 10 else "")
    return [f"{len(rows)} sightings may as well be wrong, and the two robots then stand further apart: {named}"]


def doubtful_warnings(net: BearingNetwork, outside: np.ndarray, doubt: float) -> list[str]:
    """What stands against places outside whose covariance robots are with probability `outside` (n,), over `doubt`."""
    robots = np.flatnonzero(outside > doubt)
    if not len(robots):
        return []
    robots = robots[np.argsort(-outside[robots], kind="stable")]
    named = ", ".join(f"{net.ids[k]} ({100 * outside[k]:.0f} %)" for k in robots[:10].tolist())
    named += ", .." if len(robots) > 10 else ""
    whose = "a robot" if len(robots) == 1 else f"{len(robots)} robots"
    return [f"other sightings may be the wrong ones, and {whose} then elsewhere (probability): {named}"]


def support_warnings(net: BearingNetwork, robots: np.ndarray) -> list[str]:
    """What stands against the places of `robots` (indices), whose own sightings contradict each other too much."""
    if not len(robots):
        return []
    names = ", ".join(net.ids[k] for k in robots[:10].tolist()) + (", .." if len(robots) > 10 else "")
    return [f"so many sightings of {len(robots)} robots were called wrong that their others prove nothing: {names}"]


def chi2_warnings(chi2: float, dof: int, cfg: VerdictConfig = VERDICT) -> list[str]:
    """What stands against trusting residuals of `chi2` with `dof` degrees of freedom."""
    if dof <= 0:
        counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
        return [f"no sightings are left over to check the positions with ({counted})"]
    if chi2 <= chi2_quantile(1 - cfg.doubt, float(dof)):
        return []
    counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
    return [f"the residuals are larger than sigma says ({counted}): outliers, a bias, or sigma too small"]


def faint_remarks(chi2: float, dof: int, cfg: VerdictConfig = VERDICT) -> list[str]:
    """What is said of residuals far smaller than sigma: the positions may well be right, their covariance is not."""
    if dof <= 0 or chi2 >= chi2_quantile(cfg.doubt, float(dof)):
        return []
    counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
    return [f"the residuals are far smaller than sigma says ({counted}): sigma too large, or rows that are copies"]


def barely_determined(net: BearingNetwork, position: np.ndarray, cov: np.ndarray, localisable: np.ndarray) -> list[str]:
    """Robots that the null space calls localisable, but no better than to within their distance to those they see."""
    span = float(np.median(np.linalg.norm(position[net.target] - position[net.observer], axis=1)))
    worst = np.sqrt(np.linalg.eigvalsh(cov[localisable]).max(axis=1, initial=0.0))
    count = int(np.count_nonzero(worst > span))
    if not count or count > 0.5 * len(worst):  # most robots at once: that is the scale, said elsewhere
        return []
    return [f"robots barely determined, by rays nearly parallel: {count}; the covariance may fall short of their error"]


def close_remarks(pairs: int) -> list[str]:
    """What is said of `pairs` of robots whose distance is hardly known."""
    if not pairs:
        return []
    named = f"{pairs} pairs of robots that see each other stand" if pairs > 1 else "a pair of robots that sight stands"
    return [f"{named} so close that the distance is not known: the covariance counts their sightings accordingly"]


def layout_warnings(net: BearingNetwork, localisable: np.ndarray, in_line: int) -> list[str]:
    """What in the layout itself stands against locating it."""
    warnings = []
    if len(net.anchors) > 1 and len({tuple(p) for p in net.anchors.values()}) == 1:
        warnings.append("all anchors stand at one place: they fix no scale")
    if in_line:
        line = f"{in_line} robots stand on one line, all sightings parallel but for noise"
        warnings.append(f"{line}: nothing tells how far")
    lost = int(np.count_nonzero(~localisable))
    if lost:
        warnings.append(f"{lost} of {len(net)} robots cannot be located from these sightings")
    return warnings
