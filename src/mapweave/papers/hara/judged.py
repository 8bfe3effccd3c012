"""The numbers by which `reproduce hara` judges the paper's claims."""

from typing import TYPE_CHECKING

import numpy as np

from ..verdicts import Numbers
from .starts import counts

if TYPE_CHECKING:
    from .reproduce import HaraReproduction


def numbers(r: "HaraReproduction") -> Numbers:
    """By the names of the rules: errors in metres, ratios of errors, shares."""
    odometry, icp = r.drives("odometry"), r.drives("Intensity-ICP")
    printed, ours = r.drives("paper's RBPF, raw intensity"), r.drives("our RBPF, intensity")
    narrow, alone, gated = r.gate[1], r.gate[-2], r.gate[-1]
    outside, rightly = r.refusals()
    light, walls = (r.best(what)[1] for what in ("intensity", "geometry"))
    square = r.best("intensity", squared=True)[1]
    bound = float(np.sqrt(np.mean(r.bounds.geometry**2)))
    seen, bare = counts(r.starts, "normalised"), counts(r.starts, "none")
    inside = [s.answer == "right" for s in r.starts if (s.feature, s.where) == ("normalised", "here")]
    return {
        "odometry": odometry.tolist(),
        "icp": (icp / odometry).tolist(),
        "gate_fails": [float(alone.ate.mean() / narrow.ate.mean())],
        "gate_saves": [float(gated.ate.mean() / alone.ate.mean())],
        "gate_right": [rightly / outside if outside else float("nan")],
        "printed": (printed / icp).tolist(),
        "ours": (ours / icp).tolist(),
        "geometry": [light / walls],
        "geometry_bound": [square / bound if bound > 0 else float("nan")],
        "alpha": [float(r.alpha.at_estimate.mean() / r.alpha.ate.mean(axis=1).min())],
        "feature": [float(ours.mean() / printed.mean())],
        "starts_wrong": [float(n["wrong"]) for n in (seen, bare)],
        "starts_right": [float(np.mean(inside)) if inside else float("nan")],
    }
