"""Trajectories laid where position fixes say: an absolute factor a fix, from no guess, robust.

The poses are those of the world the fixes are told in, so that where a map lies there, its heading too, is where its
first pose does. Receivers err by more than they say, for minutes on end, and now and then by a hundred metres: each
receiver's noise is what its residuals say (never less than it says itself), a fix counts as much less as errors last
longer than a fix, and fixes that are far off fade by a redescending kernel and are left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..solve import Cauchy, Factor, Kernel, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from .factors import PRUNED, columns_of, lasting, motion_factor
from .network import Motions

FEWEST = 5  # fixes that lay a trajectory
UNTOLD = 1.0  # [m] sd of a fix that does not tell it, until its residuals do
LEAST = 0.01  # times that, at least
SURE_TURN = 0.35  # [rad] sd of a map's heading from which on it is not known
PAIRS, LOOKED = 300, 400  # of fixes that make a hypothesis, and fixes that judge it
SPREAD = 0.3  # of the extent of the way, between the two fixes of a pair at least
MEDIAN2 = 1.3863  # of the squared norm of two standard Gaussians: 2 ln 2
FAR2 = 13.82  # squared sd from which a fix is wrong: 99.9 % of 2 degrees of freedom
WIDE = Cauchy(2.0)  # while poses and noise are still guesses
ROUNDS, SETTLED = 12, 0.05  # of them at most, and the share of noise that the last may change it by
MIRROR = 0.6  # of the distances: so much nearer, and the fixes are those of the mirrored way
OUT = 1e6  # times its sd: a fix that is left out
SOLVE = SolveConfig(max_iterations=30, damping=1e-4, step_tolerance=1e-5, cost_tolerance=1e-7)


@dataclass(frozen=True, slots=True)
class Sights:
    """k fixes: antenna `arm` (k, 2) [m] in the frame of `node` (k,) was at `z` (k, 2) [m] in the world at t (k,) [s].

    cov: (k, 2, 2) [m^2], NaN where it is not told; of: (k,) which receiver's, from 0.
    """

    node: Int[np.ndarray, " k"]
    arm: Float[np.ndarray, "k 2"]
    z: Float[np.ndarray, "k 2"]
    cov: Float[np.ndarray, "k 2 2"]
    t: Float[np.ndarray, " k"]
    of: Int[np.ndarray, " k"]

    def at(self, pose: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 2"]:
        """Where the antennas are when nodes stand at `pose`."""
        return np.asarray(se2.act(pose[self.node], self.arm))

    def select(self, rows: np.ndarray) -> "Sights":
        return Sights(*(getattr(self, name)[rows] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class Receivers:
    """Of each receiver: how many times its errors are what it says ([m] where it says nothing), and for how many fixes
    one lasts.
    """

    scale: Float[np.ndarray, " r"]
    lasting: Float[np.ndarray, " r"]


@dataclass(frozen=True, slots=True)
class Laid:
    """pose: (n, 3) in the world; residual: (k, 2) [m]; far: (k,) which are wrong; solution: of the poses, in order, and
    of what else was solved for after them.
    """

    pose: Float[np.ndarray, "n 3"]
    residual: Float[np.ndarray, "k 2"]
    far: Bool[np.ndarray, " k"]
    receivers: Receivers
    solution: Solution

    def covariances(self) -> Float[np.ndarray, "n 3 3"]:
        """Of every pose in the world."""
        return self.solution.blocks(columns_of(np.arange(len(self.pose))))

    def relative(self, first: int) -> Float[np.ndarray, "n 3 3"]:
        """Of every pose seen from the pose `first`, in that one's axes."""
        assert self.solution.information is not None  # noqa: S101  (`lay` gives none without)
        n = len(self.pose)
        held = 3 * first + np.arange(3)
        across = self.solution.information.columns(held)[: 3 * n].reshape(n, 3, 3)
        A, B = se2.between_jacobians(np.broadcast_to(self.pose[first], (n, 3)), self.pose)
        mixed = B @ across @ A.swapaxes(1, 2)
        P = B @ self.covariances() @ B.swapaxes(1, 2) + A @ across[first] @ A.swapaxes(1, 2)
        P = P + mixed + mixed.swapaxes(1, 2)
        P[first] = 0.0
        return np.asarray(0.5 * (P + P.swapaxes(1, 2)))


def fix_factor(s: Sights, cov: Float[np.ndarray, "k 2 2"], kernel: Kernel | None) -> Factor:
    """`x_node arm - z`, whitened: the absolute factor of a position, not of a heading."""
    W = np.linalg.cholesky(np.linalg.inv(cov)).swapaxes(1, 2)
    at = columns_of(s.node)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(se2.act(x[at], s.arm) - s.z)

    def jacobian(x: np.ndarray) -> np.ndarray:
        turned = (se2.rotation(x[at[:, 2]]) @ s.arm[..., None])[..., 0]
        J = np.zeros((len(at), 2, 3))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2], J[:, 1, 2] = -turned[:, 1], turned[:, 0]
        return J

    return Factor(at, residual, jacobian, 2, W, kernel, "fixes")


def registered(p: Float[np.ndarray, "k 2"], z: Float[np.ndarray, "k 2"]) -> tuple[Float[np.ndarray, "3"], float]:
    """The pose of p's frame in z's under which the summed distances are least, of those that pairs of points make.

    And their mean [m]. Fewer than half of the points may lie anywhere.
    """
    rows = np.unique(np.linspace(0, len(p) - 1, min(len(p), LOOKED)).astype(int))
    p, z = p[rows], z[rows]
    i, j = np.triu_indices(len(p), 1)
    way = np.hypot(*(p[j] - p[i]).T)
    long = np.flatnonzero(way >= SPREAD * way.max())
    long = long[np.unique(np.linspace(0, len(long) - 1, min(len(long), PAIRS)).astype(int))]
    i, j = i[long], j[long]
    d, e = p[j] - p[i], z[j] - z[i]
    theta = np.arctan2(e[:, 1], e[:, 0]) - np.arctan2(d[:, 1], d[:, 0])
    middle = (se2.rotation(theta) @ (0.5 * (p[i] + p[j]))[..., None])[..., 0]
    T = np.column_stack([0.5 * (z[i] + z[j]) - middle, theta])
    T[:, :2] += np.median(z - se2.act(T[:, None], p), axis=1)
    cost = np.hypot(*np.moveaxis(se2.act(T[:, None], p) - z, -1, 0)).mean(axis=1)
    best = int(np.argmin(cost))
    return T[best], float(cost[best])


def mirrored(p: Float[np.ndarray, "k 2"], z: Float[np.ndarray, "k 2"]) -> bool:
    """Whether z is the way of p seen in a mirror: the sign of a latitude or a longitude is wrong."""
    return registered(p, z * np.array([1.0, -1.0]))[1] < MIRROR * registered(p, z)[1]


def turn_sd(p: Float[np.ndarray, "k 2"], sd: float) -> float:
    """[rad] to which fixes of so many metres tell the heading of a way of these points."""
    return sd / max(float(np.sqrt(np.square(p - np.median(p, axis=0)).sum() / 2)), 1e-9)


def lay(pose: Float[np.ndarray, "n 3"], motions: Motions, sights: Sights) -> Laid | None:
    """All poses in the world, from `pose`, about where they lie there; None where fixes do not hold them all."""
    steps = [motion_factor(motions)] if len(motions.first) else []
    return lay_among(np.ravel(pose), len(pose), steps, sights)


def lay_among(
    x0: Float[np.ndarray, " m"],
    n: int,
    terms: Sequence[Factor],
    sights: Sights,
    fixed: Bool[np.ndarray, " m"] | None = None,
    ordered: Callable[[Pattern], Pattern] = Pattern.in_threes,
    before: Sequence[Sequence[Factor]] = (),
) -> Laid | None:
    """`lay`, where more than motions ties poses: x, of which the first 3n entries are poses, is what `terms` are over.

    x0: about where all lies in the world; fixed: entries that are held, no poses; ordered: in which order the problem
    is eliminated; before: what stands in place of `terms` first, one after the other, for starts that are far off.
    """
    white, told = _told(sights)
    x, far = np.array(x0, dtype=float), np.zeros(len(sights.t), bool)
    angles = wrapping(3 * np.arange(n) + 2)
    pattern: Pattern | None = None
    receivers = _receivers(sights, white, x[: 3 * n].reshape(-1, 3))

    def solved(
        kernel: Kernel | None, last: Float[np.ndarray, " r"], terms: Sequence[Factor] = terms
    ) -> tuple[Solution, Float[np.ndarray, "n 3"]]:
        nonlocal pattern
        times = receivers.scale**2 * last
        cov = told * times[sights.of, None, None] * np.where(far, OUT**2, 1.0)[:, None, None]
        problem = Problem(x, [*terms, fix_factor(sights, cov, kernel)], fixed, angles)
        pattern = pattern or ordered(Pattern.of(problem))
        found = minimise(problem, SOLVE, pattern)
        return found, found.x[: 3 * n].reshape(-1, 3)

    for softer in before:
        x = solved(WIDE, np.ones(len(receivers.scale)), softer)[0].x
    for _ in range(ROUNDS):
        found, laid = solved(WIDE, np.ones(len(receivers.scale)))
        x, was, receivers = found.x, receivers, _receivers(sights, white, laid)
        if np.abs(receivers.scale / was.scale - 1.0).max() < SETTLED:
            break
    for _ in range(2):
        e = (white @ (sights.at(laid) - sights.z)[..., None])[..., 0] / receivers.scale[sights.of, None]
        far = np.square(e).sum(axis=1) > FAR2
        found, laid = solved(None, receivers.lasting)
        x, receivers = found.x, _receivers(sights, white, laid)
    if found.information is None or not np.isfinite(x).all():
        return None
    return Laid(laid, sights.at(laid) - sights.z, far, receivers, found)


def _told(s: Sights) -> tuple[Float[np.ndarray, "k 2 2"], Float[np.ndarray, "k 2 2"]]:
    """What whitens each fix by what it says of itself, and that covariance."""
    unknown = ~np.isfinite(s.cov).all(axis=(1, 2))
    cov = np.where(unknown[:, None, None], UNTOLD**2 * np.eye(2), s.cov)
    return np.linalg.cholesky(np.linalg.inv(cov)).swapaxes(1, 2), cov


def _receivers(s: Sights, white: np.ndarray, pose: np.ndarray) -> Receivers:
    """What residuals tell of each receiver; those that say their noise are never taken to be better than that."""
    e = (white @ (s.at(pose) - s.z)[..., None])[..., 0]
    n = int(s.of.max(initial=-1)) + 1
    scale, long = np.ones(n), np.ones(n)
    for r in range(n):
        mine = np.flatnonzero(s.of == r)
        if not len(mine):
            continue
        square = np.square(e[mine]).sum(axis=1)
        stated = np.isfinite(s.cov[mine, 0, 0]).mean() > 0.5
        kept = np.ones(len(mine), bool)
        for _ in range(PRUNED):
            scale[r] = max(1.0 if stated else LEAST, float(np.sqrt(np.median(square[kept]) / MEDIAN2)))
            kept = square <= FAR2 * scale[r] ** 2
        good = mine[kept]
        good = good[np.argsort(s.t[good], kind="stable")]
        long[r] = max(lasting(e[good, 0]), lasting(e[good, 1]))
    return Receivers(scale, long)
