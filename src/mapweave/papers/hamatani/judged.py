"""The numbers by which `reproduce hamatani` judges the paper's claims."""

from typing import TYPE_CHECKING

import numpy as np

from ..verdicts import Numbers
from . import figures
from .beyond import Beyond
from .experiments import VARIANCES
from .printed import PRINTED

if TYPE_CHECKING:
    from .reproduce import HamataniReproduction

NOISY = VARIANCES[1:]  # of the bearings


def numbers(r: "HamataniReproduction") -> Numbers:
    """By the names of the rules; lengths in metres, angles in degrees."""
    table = {
        (t, far): [r.value(t, g, b) / PRINTED[t][g, b] for g in VARIANCES if (g == VARIANCES[-1]) == far for b in NOISY]
        for t in PRINTED
        for far in (False, True)
    }
    plane, space = ([row for row in r.beyond if row.case.dim == d] for d in (2, 3))
    few, many = ([row for row in plane if (row.case.robots > 5) == large] for large in (False, True))
    return {
        **{f"table{t}{' from afar' if far else ''}": ratios for (t, far), ratios in table.items()},
        "exact": [r.value(3, g, 0.0) for g in VARIANCES],
        "drift": [float(r.drift[0].side.mean() / r.drift[1].side.mean())],
        "angles": [r.value(2, g, b) for g in VARIANCES for b in NOISY],
        "sides": [r.value(3, g, b) for g in VARIANCES for b in NOISY],
        "places": [figures.worst(r.example.known, r.example.truth)],
        "grows": [r.value(t, g, NOISY[1]) / r.value(t, g, NOISY[0]) for t in PRINTED for g in VARIANCES],
        **_located("random", few),
        **_located("many", many),
        **_located("space", space),
    }


def _located(name: str, rows: list[Beyond]) -> Numbers:
    return {
        f"{name}, bound": [row.over_bound for row in rows],
        f"{name}, nees": [float(np.median(row.nees)) for row in rows],
    }
