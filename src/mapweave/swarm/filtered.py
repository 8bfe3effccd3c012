"""`locate` by a filter: one update with all sightings, from a first estimate."""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from ..core.errors import DataError
from .config import VERDICT, SwarmConfig, VerdictConfig
from .factors import bearing_factor
from .gauge import gauge_of
from .kalman import FilterState, Form, filter_start, update
from .linear import linear_pattern, linear_start
from .network import Network, components
from .observability import observe
from .result import JointInformation, Status, SwarmEstimate
from .verdict import chi2_warnings, layout_warnings

TOO_MANY = 6000  # sightings beyond which a dense update would need gigabytes


def filtered(net: Network, cfg: SwarmConfig, form: Form, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The posterior of one update from `initial`, or from the linear start when there is none.

    The filters know the first estimate as a prior, so that a gauge is held by it: said in `gauge`, and counted in
    `dof`. Raises DataError without a common axis, and beyond `TOO_MANY` rows.
    """
    if len(net.observer) * (net.dim - 1) > TOO_MANY:
        raise DataError(f"{len(net.observer)} sightings are too many for a dense filter: use the batch method")
    if net.distances:
        raise DataError("the filters take no known distances: use the batch method")
    parts = components(net)
    if initial is None:
        plain = replace(net, axis=True)
        initial = linear_start(plain, parts, plain.direction, *linear_pattern(plain, parts))
    state = update(filter_start(net, initial, cfg.prior_sigma), net, form, cfg.max_iterations)
    return report(net, state, form, cfg.verdict)


def report(net: Network, state: FilterState, form: Form, verdict: VerdictConfig = VERDICT) -> SwarmEstimate:
    """What a filter state says, as an estimate."""
    n, dim = len(net), net.dim
    parts = components(net)
    seen = observe(net, parts, state.x)
    gauge = gauge_of(net, parts, seen.localisable)
    full = np.zeros((n * dim, n * dim))
    full[np.ix_(state.free, state.free)] = state.P
    index = np.arange(n * dim).reshape(n, dim)
    cov = full[index[:, :, None], index[:, None, :]]
    cov[~seen.localisable] = np.nan
    exact = not np.any(net.sigma > 0)
    chi2 = float(bearing_factor(net).squares(state.x.ravel()).sum())
    dof = len(net.observer) * (dim - 1) - len(state.free) + seen.nullity
    doubts = [] if exact else chi2_warnings(chi2, dof, verdict)
    held = np.ones(n * dim, dtype=bool)
    held[state.free] = False
    information = None
    if not exact and len(state.free):
        inverse = np.zeros_like(full)
        inverse[np.ix_(state.free, state.free)] = np.linalg.inv(state.P)
        information = JointInformation(sp.csc_matrix(inverse), held, dim)
    return SwarmEstimate(
        ids=net.ids,
        dim=dim,
        method=form,
        position=state.x,
        cov=cov,
        localisable=seen.localisable,
        anchor=net.is_anchor,
        outlier=np.zeros(len(net.observer), dtype=bool),
        gauge="held by the first estimate alone: " + gauge.free if gauge.name else "",
        null_space=seen.nullity,
        iterations=state.iterations,
        chi2=chi2,
        dof=dof,
        status=Status.CONVERGED if np.isfinite(state.x).all() else Status.FAILED,
        reliable=not doubts and bool((seen.localisable & ~net.is_anchor).any()),
        warnings=(*doubts, *layout_warnings(net, seen.localisable, seen.in_line)),
        information=information,
    )
