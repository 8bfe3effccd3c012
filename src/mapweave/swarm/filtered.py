"""`locate` by a filter: one update with all sightings, from a first estimate."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool

from ..core.errors import DataError
from .config import VERDICT, SwarmConfig, VerdictConfig
from .factors import bearing_factor, width
from .gauge import gauge_of
from .headings import headings_at
from .kalman import FilterState, Form, filter_start, update
from .network import BearingNetwork, components
from .observability import observe
from .result import JointInformation, SwarmEstimate, SwarmStatus
from .start import linear_pattern, linear_start, prepare
from .verdict import chi2_warnings, layout_warnings

TOO_MANY = 6000  # sightings beyond which a dense update would need gigabytes


def filtered(net: BearingNetwork, cfg: SwarmConfig, form: Form, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The posterior of one update from `initial`, or from the linear start when there is none.

    The filters know the first estimate as a prior, so that a gauge is held by it: said in `gauge`, and counted in
    `dof`. Without a common axis headings are part of the state; nothing is known of them before, and they are
    linearised where they fit the first positions. Raises DataError beyond `TOO_MANY` rows, and where no heading can be
    started.
    """
    if len(net.observer) * (net.dim - 1) > TOO_MANY:
        raise DataError(f"{len(net.observer)} sightings are too many for a dense filter: use the batch method")
    if net.distances:
        raise DataError("the filters take no known distances: use the batch method")
    used, heading = np.ones(len(net.observer), dtype=bool), None
    if not net.axis:
        net, used, initial, heading = _with_headings(net, initial)
    elif initial is None:
        parts = components(net)
        initial = linear_start(net, parts, net.direction, *linear_pattern(net, parts))
    state = update(filter_start(net, initial, cfg.prior_sigma, heading), net, form, cfg.max_iterations)
    return report(net, state, form, cfg.verdict, ~used)


def _with_headings(
    net: BearingNetwork, initial: np.ndarray | None
) -> tuple[BearingNetwork, np.ndarray, np.ndarray, np.ndarray]:
    """The sightings whose observer's heading can be started, (m,) which they are, first positions and headings."""
    if initial is None:
        start = prepare(net)
        position, heading = start.position, start.heading
        assert heading is not None  # noqa: S101  (no axis is common)
        return net.select(start.used), start.used, position, heading
    first = np.array(initial, dtype=float)
    for k, p in net.anchors.items():
        first[k] = p
    return net, np.ones(len(net.observer), dtype=bool), first, headings_at(net, first)


def report(
    net: BearingNetwork,
    state: FilterState,
    form: Form,
    verdict: VerdictConfig = VERDICT,
    outlier: Bool[np.ndarray, " m"] | None = None,
) -> SwarmEstimate:
    """What a filter state says, as an estimate; outlier: (m,) of the whole network when `net` holds the others only."""
    n, dim, w = len(net), net.dim, width(net)
    parts = components(net)
    seen = observe(net, parts, state.x[:, :dim])
    gauge = gauge_of(net, parts, seen.localisable)
    full = np.zeros((n * w, n * w))
    full[np.ix_(state.free, state.free)] = state.P
    index = np.arange(n * w).reshape(n, w)[:, :dim]
    cov = full[index[:, :, None], index[:, None, :]]
    cov[~seen.localisable] = np.nan
    exact = not np.any(net.sigma > 0)
    chi2 = float(bearing_factor(net).squares(state.x.ravel()).sum())
    dof = len(net.observer) * (dim - 1) - len(state.free) + seen.nullity
    doubts = [] if exact else chi2_warnings(chi2, dof, verdict)
    held = np.ones(n * w, dtype=bool)
    held[state.free] = False
    information = None
    if not exact and len(state.free):
        inverse = np.zeros_like(full)
        inverse[np.ix_(state.free, state.free)] = np.linalg.inv(state.P)
        information = JointInformation(sp.csc_matrix(inverse), held, w)
    return SwarmEstimate(
        ids=net.ids,
        dim=dim,
        method=form,
        position=state.x[:, :dim],
        cov=cov,
        localisable=seen.localisable,
        anchor=net.is_anchor,
        outlier=np.zeros(len(net.observer), dtype=bool) if outlier is None else outlier,
        gauge="held by the first estimate alone: " + gauge.free if gauge.name else "",
        null_space=seen.nullity,
        iterations=state.iterations,
        chi2=chi2,
        dof=dof,
        status=SwarmStatus.CONVERGED if np.isfinite(state.x).all() else SwarmStatus.FAILED,
        reliable=not doubts and bool((seen.localisable & ~net.is_anchor).any()),
        warnings=(*doubts, *layout_warnings(net, seen.localisable, seen.in_line)),
        heading=None if net.axis else state.x[:, dim],
        heading_var=None if net.axis else np.where(seen.localisable, np.diag(full)[dim::w], np.nan),
        information=information,
    )
