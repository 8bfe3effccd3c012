"""Fusion while the robots drive: a fresher version of a map takes the place of its older contribution.

`Lambda += new - old`: nothing is counted twice, and no other map has to be sent again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Information
from . import relative_information
from .relative import RelativeConfig, RelativeFusion, as_measurement
from .relative_measurement import Layout


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one map adds: information W (k, k) and vector eta (k,) over the entries `columns` of the state."""

    columns: Int[np.ndarray, " k"]
    W: Float[np.ndarray, "k k"]
    eta: Float[np.ndarray, " k"]


@dataclass(frozen=True, slots=True)
class RelativeState:
    """The running sum of all maps' information, `Lambda x = eta`, and which part each map gave."""

    layout: Layout
    ids: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    contributions: Mapping[int, Contribution]
    Lambda: sp.csc_matrix
    eta: Float[np.ndarray, " size"]
    x: Float[np.ndarray, " size"]

    @property
    def points(self) -> Float[np.ndarray, "n 2"]:
        return self.layout.points(self.x)

    def covariance(self) -> Float[np.ndarray, "size size"]:
        return Information.of(self.Lambda).covariance()


def begin(maps: Sequence[LandmarkMap], fused: RelativeFusion, cfg: RelativeConfig | None = None) -> RelativeState:
    """The state after all `maps`, linearised where they were `fused` (without a prior)."""
    cfg = cfg or RelativeConfig()
    parts = {
        k: _contribution(k, m, pair, fused.layout, fused.ids, fused.x, cfg)
        for k, (m, pair) in enumerate(zip(maps, fused.pairs, strict=True))
    }
    n = fused.layout.size
    Lambda, eta = sp.csc_matrix((n, n)), np.zeros(n)
    for part in parts.values():
        Lambda, eta = Lambda + _spread(part, n), _add(eta, part, 1.0)
    return RelativeState(fused.layout, fused.ids, fused.pairs, parts, Lambda, eta, fused.x)


def replace_map(state: RelativeState, k: int, fresher: LandmarkMap, cfg: RelativeConfig | None = None) -> RelativeState:
    """The state with map k's contribution exchanged for that of its fresher version, linearised at the state's mean.

    Landmarks new in it are appended where the frame's present pose puts them. The baseline is chosen anew among the
    landmarks that other maps have too.
    """
    cfg = cfg or RelativeConfig()
    state = _with_room(state, k, fresher)
    layout, n = state.layout, state.layout.size
    elsewhere = {int(c) for i, part in state.contributions.items() if i != k for c in part.columns}
    place = {name: i for i, name in enumerate(state.ids)}
    shared = [i for i, name in enumerate(fresher.ids) if layout.first_landmark + 2 * place[name] in elsewhere]
    i, j = relative_information.baseline_pair(fresher.mean, fresher.cov, np.array(shared) if len(shared) > 1 else None)
    pair = (fresher.ids[i], fresher.ids[j])
    old, new = state.contributions[k], _contribution(k, fresher, pair, layout, state.ids, state.x, cfg)
    Lambda = (state.Lambda + (_spread(new, n) - _spread(old, n))).tocsc()
    eta = _add(_add(state.eta, new, 1.0), old, -1.0)
    x = Information.of(Lambda).solve(eta)
    pairs = tuple(pair if at == k else p for at, p in enumerate(state.pairs))
    return RelativeState(layout, state.ids, pairs, {**state.contributions, k: new}, Lambda, eta, x)


def _contribution(
    k: int,
    m: LandmarkMap,
    pair: tuple[str, str],
    layout: Layout,
    ids: tuple[str, ...],
    x: Float[np.ndarray, " size"],
    cfg: RelativeConfig,
) -> Contribution:
    told = as_measurement(k, m, pair, {name: i for i, name in enumerate(ids)}, cfg)
    e, H = told.linearise(layout, x)
    HTW = cfg.repeats * np.linalg.solve(told.R, H).T
    columns = told.columns(layout)
    return Contribution(columns, HTW @ H, HTW @ (e + H @ x[columns]))


def _with_room(state: RelativeState, k: int, fresher: LandmarkMap) -> RelativeState:
    known = set(state.ids)
    new = [i for i, name in enumerate(fresher.ids) if name not in known]
    if not new:
        return state
    layout = Layout(state.layout.frames, state.layout.landmarks + len(new))
    points = se2.act(state.layout.frame(state.x, k), fresher.mean[new]).ravel()
    Lambda = sp.csc_matrix(sp.block_diag([state.Lambda, sp.csc_matrix((len(points), len(points)))]))
    eta = np.concatenate([state.eta, np.zeros(len(points))])
    ids = (*state.ids, *(fresher.ids[i] for i in new))
    return RelativeState(layout, ids, state.pairs, state.contributions, Lambda, eta, np.concatenate([state.x, points]))


def _spread(part: Contribution, n: int) -> sp.csc_matrix:
    k = len(part.columns)
    rows, columns = np.repeat(part.columns, k), np.tile(part.columns, k)
    return sp.csc_matrix((part.W.ravel(), (rows, columns)), shape=(n, n))


def _add(eta: Float[np.ndarray, " size"], part: Contribution, sign: float) -> Float[np.ndarray, " size"]:
    out = eta.copy()
    out[part.columns] += sign * part.eta
    return out
