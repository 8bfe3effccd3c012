"""What residuals tell of how ranges and odometry err: noise of each pair of radios, how long an error lasts, scatter of
stamps, which ranges went another way, and when odometry errs more than it does mostly.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..solve import Factor, Solution
from .factors import PRUNED, lasting
from .network import RangeNetwork, Ranges

LEAST_SD = 0.01  # [m] noise of a range, whatever its residuals say: radios count in centimetres
TO_SD = 1.4826  # times half the width of its densest half is the sd of a Gaussian
ANYTHING = 3.0  # [m] by up to which one that went another way is too long
FAR = 3.0  # [sd] from which a range is taken for one that went another way
WITHIN_FAR = 1.0136  # times what scatters within it is the sd of a Gaussian
SURE = 3.0  # sd from which ranges are told to scatter more the faster their ends part: their stamps do
WINDOW = 10.0  # [s] over which odometry may err more than it is taken to, and than it does mostly:
MOSTLY = 0.25  # quantile of a robot's windows; what all share may as well be errors of ranges that last
WINDOW_DOF = 6.0  # that count beside a window's own, as if these erred as they are taken to
PROBES = 30  # random vectors that tell how many of a window's motions ranges check [Hutchinson, 1990]
SHRUNK = 0.02  # [m] sd of biases over all pairs, at least: a smaller one would hold them where they began


@dataclass(frozen=True, slots=True)
class RadioNoise:
    """What residuals tell: of each pair the noise [m] and for how many ranges an error lasts; which ranges are far;
    each: (k,) [m] noise of each, with that of its stamp, `jitter` [s].
    """

    residual: Float[np.ndarray, " k"]
    far: Bool[np.ndarray, " k"]
    sd: Float[np.ndarray, " p"]
    lasting: Float[np.ndarray, " p"]
    each: Float[np.ndarray, " k"]
    jitter: float = 0.0

    @classmethod
    def of(
        cls,
        r: Ranges,
        which: Int[np.ndarray, " k"],
        pairs: int,
        residual: Float[np.ndarray, " k"],
        speed: Float[np.ndarray, " k"] | None = None,
    ) -> "RadioNoise":
        """What `residual` tells; speed: (k,) [m/s] by which distances grow."""
        far, sd, long = np.zeros(len(residual), bool), np.empty(pairs), np.empty(pairs)
        for k in range(pairs):
            mine = np.flatnonzero(which == k)
            e = residual[mine]
            kept = np.ones(len(e), bool)
            for _ in range(PRUNED):
                middle, half = _densest_half(e[kept])
                sd[k] = max(LEAST_SD, TO_SD * half)
                kept = np.abs(e - middle) <= FAR * sd[k]
                kept = np.abs(e - np.median(e[kept])) <= FAR * sd[k]
            far[mine] = ~kept
            sd[k] = max(LEAST_SD, WITHIN_FAR * float(e[kept].std()))
            good = mine[~far[mine]]
            long[k] = lasting(residual[good[np.argsort(r.t[good], kind="stable")]])
        fast = np.zeros(len(residual)) if speed is None else np.square(speed)
        jitter = _jitter(np.where(far, np.nan, np.square(residual)), fast, which, sd)
        mean = np.bincount(which, np.where(far, 0.0, fast), pairs) / np.maximum(np.bincount(which, ~far, pairs), 1)
        sd = np.sqrt(np.maximum(LEAST_SD**2, sd**2 - jitter**2 * mean))
        return cls(residual, far, sd, long, np.sqrt(sd[which] ** 2 + jitter**2 * fast), jitter)


def _jitter(
    e2: Float[np.ndarray, " k"],
    fast: Float[np.ndarray, " k"],
    which: Int[np.ndarray, " k"],
    sd: Float[np.ndarray, " p"],
) -> float:
    """[s] by which stamps scatter: squares of errors that grow with those of the speeds at which ends part, if so.

    e2: NaN of those that do not count. Each pair has a noise of its own beside, about `sd`, and counts by it.
    """
    used = np.isfinite(e2)
    n = np.maximum(np.bincount(which[used], minlength=len(sd)), 1)
    mean = [np.bincount(which[used], v[used], len(sd)) / n for v in (e2, fast)]
    y, x = ((v - m[which])[used] / np.square(sd[which[used]]) for v, m in zip((e2, fast), mean, strict=True))
    power = float(x @ x)
    if power <= 0.0:
        return 0.0
    slope = float(x @ y) / power
    slope_sd = float(np.sqrt(np.square(x * (y - slope * x)).sum())) / power
    return float(np.sqrt(slope)) if slope > SURE * slope_sd else 0.0


def unlikely(noise: RadioNoise, r: Ranges, which: Int[np.ndarray, " k"]) -> float:
    """Less twice the logarithm of the likelihood of the ranges: each but the far ones goes on from its pair's last.

    A layout that is wrong is made up for by noise that is greater and lasts longer, which squares over the noise hide.
    """
    sd = np.fmax(r.sd, noise.each)
    long = noise.lasting[which]
    new = sd * 2.0 * np.sqrt(long) / (long + 1.0)  # of an error, beside what is left of the last, as it lasts so long
    each = np.square(noise.residual / sd) + 2.0 * np.log(new) + np.log(2.0 * np.pi)
    return float(np.where(noise.far, 2.0 * np.log(ANYTHING), each).sum())


def _densest_half(e: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Middle and half width of the shortest span that holds half of the errors: where most ranges went straight.

    Those that went round something are all too long, so that a median and what scatters about it are off.
    """
    e = np.sort(e)
    h = len(e) // 2 + 1
    width = e[h - 1 :] - e[: len(e) - h + 1]
    k = int(np.argmin(width))
    return float(0.5 * (e[k] + e[k + h - 1])), float(0.5 * width[k])


def spread_of(off: Float[np.ndarray, " p"], P: Float[np.ndarray, "q q"]) -> float:
    """[m] of biases `off` what they have in common; P: covariance of biases and, last, of that."""
    apart = np.diag(P)[:-1] + P[-1, -1] - 2 * P[:-1, -1]
    return max(SHRUNK, float(np.sqrt(np.mean(np.square(off) + apart))))


def windows_of(net: RangeNetwork, motions: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Of each of `motions`, in which window of its robot's time it is."""
    first = net.motions.first[motions]
    t = np.nan_to_num(net.t[first])
    window = np.floor((t - t.min(initial=np.inf)) / WINDOW) if len(t) else t
    return np.asarray(np.unique(np.column_stack([net.owner[first], window]), axis=0, return_inverse=True)[1].ravel())


def loosened(
    steps: Factor,
    found: Solution,
    loose: Float[np.ndarray, " m"],
    window: Int[np.ndarray, " m"],
    robot: Int[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """By how many times motions err more than mostly, 1 or more, one number a window, whose motions are of one robot.

    A variance component [Helmert, 1924]: squares of whitened residuals over how many of them the rest of the problem
    checks. steps: the motions as they were taken to err, `loose` times as they are by themselves.
    """
    V = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(loose), steps.rows, PROBES))
    J, at = np.asarray(steps.sqrt_info) @ steps.jacobian(found.x), steps.columns
    u = np.zeros((len(found.x), PROBES))
    np.add.at(u, at, np.einsum("mrc,mrp->mcp", J, V))
    y = np.zeros_like(u)
    assert found.information is not None  # noqa: S101  (asked of what is solved alone)
    y[found.free] = found.information.solve(u[found.free])
    checked = (V * (V - np.einsum("mrc,mcp->mrp", J, y[at]))).mean(axis=2).sum(axis=1)
    squares, dof = (np.bincount(window, v) for v in (steps.squares(found.x), checked))
    times = np.sqrt((squares + WINDOW_DOF) / (np.maximum(dof, 0.0) + WINDOW_DOF))
    first = np.unique(window, return_index=True)[1]
    each, of = (loose * times[window])[first], robot[first]
    for k in np.unique(of):
        each[of == k] /= max(1.0, float(np.quantile(each[of == k], MOSTLY, method="lower")))
    return np.asarray(np.maximum(each, 1.0)[window])
