"""Whether an answer may be trusted, in plain words."""

import numpy as np

from ...core.gaussian import chi2_quantile
from ...maps.network import Network

DOUBT = 1e-3  # probability below which a chi-square is called wrong


def chi2_warnings(chi2: float, dof: int) -> list[str]:
    """What stands against trusting residuals of `chi2` with `dof` degrees of freedom."""
    if dof <= 0 or chi2 <= chi2_quantile(1 - DOUBT, float(dof)):
        return []
    found = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
    return [f"the residuals are larger than sigma says ({found}): outliers, a bias, or sigma too small"]


def layout_warnings(net: Network, localisable: np.ndarray) -> list[str]:
    """What in the layout itself stands against locating it."""
    told = []
    if len(net.anchors) > 1 and len({tuple(p) for p in net.anchors.values()}) == 1:
        told.append("all anchors stand at one place: they fix no scale")
    lost = int(np.count_nonzero(~localisable))
    if lost:
        told.append(f"{lost} of {len(net)} robots cannot be located from these sightings")
    return told
