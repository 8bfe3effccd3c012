"""Kalman filters of bearings (extended, iterated, first-estimate Jacobians), and `locate` by one update of them."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from ..core.errors import DataError
from ..core.gaussian import solve_psd, symmetrise
from ..core.se2 import wrap_angle
from .config import SwarmConfig
from .factors import bearing_factor, width
from .network import BearingNetwork, components
from .observability import gauge_of, observe
from .posterior import chi2_warnings, layout_warnings
from .result import JointInformation, SwarmEstimate, SwarmStatus
from .start import headings_at, linear_pattern, linear_start, prepare

Form = Literal["ekf", "iekf", "fej"]
STEP_TOLERANCE = 1e-9  # [m]; an iterated update ends when no coordinate moves further
HALVINGS = 30  # of a step, to a thousand-millionth
RANK = 1e-10  # singular values below this share of the largest are zero (exact sightings)
ANY_HEADING = float(np.pi / np.sqrt(3.0))  # [rad]; the standard deviation of a heading that may be any


@dataclass(frozen=True, slots=True)
class FilterState:
    """x: (n, w) positions [m], anchors in their places, then headings [rad] where no axis is common.

    P: (f, f) over the `free` entries of x; first: (n, w) where it began.
    """

    x: Float[np.ndarray, "n w"]
    P: Float[np.ndarray, "f f"]
    first: Float[np.ndarray, "n w"]
    free: Int[np.ndarray, " f"]
    updates: int = 0
    iterations: int = 0


def filter_start(
    net: BearingNetwork,
    initial: Float[np.ndarray, "n d"],
    sigma: float = 10.0,
    heading: Float[np.ndarray, " n"] | None = None,
    heading_sigma: float = ANY_HEADING,
) -> FilterState:
    """The state before any sighting: known robots' places are not part of it; `sigma` [m] each free coordinate.

    heading, heading_sigma: (n,) first headings and their standard deviation [rad] where no axis is common (zero).
    Headings of robots that see nobody are not part of the state.
    """
    x, free = np.array(initial, dtype=float), np.repeat(~net.is_anchor[:, None], width(net), axis=1)
    for k, p in net.anchors.items():
        x[k] = p
    deviation = np.full(free.shape, sigma)
    if not net.axis:
        x = np.column_stack([x, np.zeros(len(net)) if heading is None else heading])
        deviation[:, net.dim] = heading_sigma
        free[:, net.dim] = False
        free[net.observer, net.dim] = True
    entries = np.flatnonzero(free)
    return FilterState(x, np.diag(deviation.ravel()[entries] ** 2), x, entries)


def update(state: FilterState, net: BearingNetwork, form: Form = "ekf", max_iterations: int = 50) -> FilterState:
    """One set of sightings taken in.

    `ekf` linearises at the estimate, `fej` always at the first one, so that directions no sighting sees gain no
    information; `iekf` linearises again at its own result until it converges. Exact sightings (sigma 0), where the
    paper's S is singular, are taken in by the pseudo-inverse, P serving as the metric and left as it is.
    """
    turns = max_iterations if form == "iekf" else 1
    prior, x = state.x.ravel()[state.free], state.x
    K, H = np.zeros((0, 0)), np.zeros((0, 0))
    exact = not np.any(net.sigma > 0)
    R = np.repeat(net.sigma**2, net.dim - 1)  # the variances of the sightings
    done = 0
    while done < turns:
        done += 1
        H = sighting_matrix(net, state.first if form == "fej" else x)[:, state.free]
        e = innovation(net, x)
        PHt = state.P @ H.T
        if exact:
            K = PHt @ np.linalg.pinv(H @ PHt, rcond=RANK, hermitian=True)
        else:
            S = H @ PHt + np.diag(R)  # [Hamatani] eq. 5
            K = _gain(S, PHt)  # [Hamatani] eq. 6
        here = x.ravel()[state.free]
        new = prior + K @ (e - H @ (prior - here))  # [Hamatani] eq. 7; the last term is zero in the first turn
        x = _placed(x, state.free, new)
        if exact:
            x = _shortened(net, here, new, state.free, x, e)
            new = x.ravel()[state.free]
        if np.abs(new - here).max(initial=0.0) < STEP_TOLERANCE:
            break
    x[:, net.dim :] = wrap_angle(x[:, net.dim :])
    P = state.P if exact else symmetrise(state.P - K @ (H @ state.P))  # [Hamatani] eq. 8
    return replace(state, x=x, P=P, updates=state.updates + 1, iterations=state.iterations + done)


def _gain(S: np.ndarray, PHt: np.ndarray) -> np.ndarray:
    """`PHt S^-1`; by the pseudo-inverse where robots so close together make S too uneven for Cholesky."""
    try:
        return solve_psd(S, PHt.T).T
    except np.linalg.LinAlgError:
        return np.asarray(PHt @ np.linalg.pinv(S, rcond=RANK, hermitian=True))


def _placed(x: np.ndarray, free: np.ndarray, values: np.ndarray) -> np.ndarray:
    out = x.ravel().copy()
    out[free] = values
    return out.reshape(x.shape)


def _shortened(
    net: BearingNetwork, here: np.ndarray, new: np.ndarray, free: np.ndarray, x: np.ndarray, e: np.ndarray
) -> np.ndarray:
    """`x`, or nearer to `here` by halves until the innovations `e` at `here` do not grow.

    Without noise nothing else bounds the step of an update far from the truth.
    """
    for _ in range(HALVINGS):
        after = innovation(net, x)
        if after @ after <= e @ e:
            break
        new = 0.5 * (here + new)
        x = _placed(x, free, new)
    return x


def sighting_matrix(net: BearingNetwork, x: Float[np.ndarray, "n w"]) -> Float[np.ndarray, "m s"]:
    """H: the dense derivative of all predicted sightings by all entries of the state, at `x`."""
    factor = bearing_factor(net)
    J = factor.jacobian(x.ravel())
    m, k, _ = J.shape
    H = np.zeros((m * k, x.size))
    rows = np.arange(m * k).reshape(m, k)
    H[rows[:, :, None], factor.columns[:, None, :]] = J
    return H


def innovation(net: BearingNetwork, x: Float[np.ndarray, "n w"]) -> Float[np.ndarray, " r"]:
    """Sightings less predictions [rad]."""
    return np.asarray(-bearing_factor(net).residual(x.ravel()).ravel())


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
    if not net.axis and net.dim == 3:
        raise DataError("in space the filters need common axes: use the batch method")
    if net.distances:
        raise DataError("the filters take no known distances: use the batch method")
    used, heading = np.ones(len(net.observer), dtype=bool), None
    if not net.axis:
        net, used, initial, heading = _with_headings(net, initial)
    elif initial is None:
        parts = components(net)
        initial = linear_start(net, parts, net.direction, *linear_pattern(net, parts))
    state = update(filter_start(net, initial, cfg.prior_sigma, heading), net, form, cfg.max_iterations)
    return report(net, state, form, ~used)


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
    doubts = [] if exact else chi2_warnings(chi2, dof)
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
