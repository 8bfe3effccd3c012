"""Many places a robot may be in one finished map, weighed by its scans until one is left."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..kernels.laser.refine import systematic
from .beam import Beams
from .laser_map import GridMap
from .likelihood_field import NearestField
from .localise_trust import TrustConfig

LOCALISE_SPACING = 0.2  # [m] between places tried and
LOCALISE_TURN = float(np.radians(5.0))  # [rad] between headings tried, when the start is searched everywhere
PER_BIN = 20  # particles for each bin that is held likely
LOCALISE_BIN = (0.5, float(np.radians(15.0)))  # [m], [rad] sides of such a bin
LOCALISE_BEAMS = 60  # of a scan are asked, spread over it
UPDATE_DISTANCE = 0.25  # [m] moved, or
UPDATE_TURN = 0.25  # [rad] moved before weights change
LOCALISE_NEFF = 10.0  # independent returns in a scan
SEARCH_SIGMA = 0.2  # [m] sd of a return while searching
SEARCH_CAP = 0.25  # [m^2] greatest squared distance a beam is charged while searching
LOCALISE_SIGMA = 0.07  # [m] sd of a return once the place is found
LOCALISE_CAP = 0.06  # [m^2] greatest squared distance a beam is charged once the place is found
LOCALISE_MATCHED = 0.04  # [m^2] squared distance below which a return of the estimate counts as matched
FREE_PASSES = 2  # beams that went through a cell in which the robot may start, at least
FOUND_XY = 0.3  # [m] within which the particles lie once the place is found, and
FOUND_TURN = float(np.radians(8.0))  # [rad]: spread under which the start counts as found
FOUND_SHARE = 0.95  # of the weight at one place, at least
ONE_XY = 1.0  # [m] and
ONE_TURN = float(np.radians(20.0))  # [rad] round the heaviest particle: one place
START_XY = 0.2  # [m] sd of a start that is told, and
START_TURN = float(np.radians(5.0))  # [rad] sd of the particles round a start that is given
LOCALISE_DOUBTS = 8  # updates in a row whose mean share is less: the place found was wrong, the search begins anew


@config
class LocaliseConfig:
    """How a robot is found and followed in a finished map, and when it is believed to be there."""

    most: int = 20_000  # particles while the start is not found, at most
    least: int = 2_000  # and at least
    sd_xy: float = 0.02  # [m] + sd_xy_per_m d: spread of the particles' moves
    sd_xy_per_m: float = 0.08  # and so much more a metre driven
    sd_turn: float = 0.01  # [rad] + sd_turn_per_m d
    sd_turn_per_m: float = 0.02  # [rad] and so much more a metre driven
    trusted: float = 0.6  # share of the returns the map must explain
    trust: TrustConfig = TrustConfig()


@dataclass(slots=True)
class Cloud:
    """poses: (P, 3) in `map`; log_weight: (P,)."""

    poses: Float[np.ndarray, "p 3"]
    log_weight: Float[np.ndarray, " p"]

    def shares(self) -> Float[np.ndarray, " p"]:
        w = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(w / w.sum())

    def middle(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float]:
        """Mean pose round the heaviest particle, spread there [m, m, rad], and the share of the weight it holds."""
        w = self.shares()
        best = self.poses[int(np.argmax(w))]
        off = self.poses - best
        off[:, 2] = se2.wrap_angle(off[:, 2])
        close = (np.hypot(off[:, 0], off[:, 1]) < ONE_XY) & (np.abs(off[:, 2]) < ONE_TURN)
        share = float(w[close].sum())
        v = w[close] / share
        mean = v @ off[close]
        spread = np.sqrt(v @ (off[close] - mean) ** 2)
        pose = best + mean
        pose[2] = se2.wrap_angle(pose[2])
        return pose, spread, share

    def covariance(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """Of all particles about `pose`, over x, y, theta."""
        off = self.poses - pose
        off[:, 2] = se2.wrap_angle(off[:, 2])
        return np.asarray((off * self.shares()[:, None]).T @ off)


class PlaceFilter:
    """The particles; every method changes them."""

    def __init__(
        self,
        walls: NearestField,
        grid: GridMap,
        alpha: float,
        how: LocaliseConfig,
        particles: int,
        rng: np.random.Generator,
    ) -> None:
        self.walls, self.grid, self.alpha, self.how, self.particles, self.rng = walls, grid, alpha, how, particles, rng
        self.cloud = Cloud(np.zeros((1, 3)), np.zeros(1))
        self.found = False

    def begin(self, start: Float[np.ndarray, "3"] | None, points: Float[np.ndarray, "n 3"]) -> None:
        """Particles round a given start, or wherever the first scan may have been taken."""
        how = self.how
        self.found = start is not None
        if start is not None:
            spread = np.array([START_XY, START_XY, START_TURN])
            poses = start + spread * self.rng.standard_normal((max(how.least, self.particles), 3))
            self.cloud = Cloud(poses, np.zeros(len(poses)))
            self.weigh(points)
            return
        places = _spaced(self.grid.free_cells(FREE_PASSES), LOCALISE_SPACING)
        headings = np.arange(-np.pi, np.pi, LOCALISE_TURN)
        best: list[np.ndarray] = []
        scores: list[np.ndarray] = []
        for part in np.array_split(places, max(1, len(places) // 2000)):
            poses = np.column_stack([np.repeat(part, len(headings), axis=0), np.tile(headings, len(part))])
            mean, _ = self.walls.score(poses, points, alpha=self.alpha, cap=SEARCH_CAP)
            best.append(poses)
            scores.append(self._gain(mean))
        log_weight = np.concatenate(scores)
        cloud = Cloud(np.concatenate(best), log_weight)
        self._draw(cloud, how.most)

    def move(self, u: Float[np.ndarray, "3"]) -> None:
        how, P = self.how, len(self.cloud.poses)
        d = float(np.hypot(u[0], u[1]))
        xy, turn = how.sd_xy + how.sd_xy_per_m * d, how.sd_turn + how.sd_turn_per_m * d
        self.cloud.poses = se2.compose(self.cloud.poses, u + self.rng.standard_normal((P, 3)) * [xy, xy, turn])

    def weigh(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Weights take the scan in; says whether the hypotheses have become one."""
        cap = LOCALISE_CAP if self.found else SEARCH_CAP
        mean, _ = self.walls.score(self.cloud.poses, points, alpha=self.alpha, cap=cap)
        self.cloud.log_weight = self.cloud.log_weight + self._gain(mean)
        if not self.found:
            _, spread, share = self.cloud.middle()
            narrow = max(spread[0], spread[1]) < FOUND_XY and spread[2] < FOUND_TURN
            self.found = narrow and share > FOUND_SHARE

    def posterior(self, b: Beams) -> tuple[Float[np.ndarray, "3"], int, float, bool]:
        """The estimate, its matched returns, the effective number before drawing anew, and whether that was done."""
        pose, _, _ = self.cloud.middle()
        every = np.column_stack([b.s, b.q])
        _, matched = self.walls.score(pose[None], every, alpha=self.alpha, cap=1.0, matched_under=LOCALISE_MATCHED)
        w = self.cloud.shares()
        n_eff = float(1.0 / (w @ w))
        wanted = max(self.particles, 50) if self.found else self._wanted(w)
        again = n_eff < 0.5 * len(w) or len(w) > 2 * wanted
        if again:
            self._draw(self.cloud, wanted)
        return pose, int(matched[0]), n_eff, again

    def _gain(self, mean: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        sigma = LOCALISE_SIGMA if self.found else SEARCH_SIGMA
        return np.asarray(-LOCALISE_NEFF / (2 * sigma**2) * mean)

    def _wanted(self, w: Float[np.ndarray, " p"]) -> int:
        """As many particles as the places that are still likely ask for."""
        likely = self.cloud.poses[w > 1e-3 / len(w)]
        size, turn = LOCALISE_BIN
        bins = len(np.unique(np.floor(likely / [size, size, turn]).astype(np.int64), axis=0))
        return int(np.clip(PER_BIN * bins, self.how.least, self.how.most))

    def _draw(self, cloud: Cloud, count: int) -> None:
        """`count` particles drawn from `cloud` by weight, evenly."""
        w = cloud.shares()
        if count == len(w):
            poses = cloud.poses[systematic(w, float(self.rng.random()))]
        else:
            at = (np.arange(count) + self.rng.random()) / count
            poses = cloud.poses[np.minimum(np.searchsorted(np.cumsum(w), at), len(w) - 1)]
        self.cloud = Cloud(poses.copy(), np.zeros(len(poses)))


def _spaced(places: Float[np.ndarray, "n 2"], spacing: float) -> Float[np.ndarray, "m 2"]:
    """One of the places for every square of side `spacing`."""
    _, first = np.unique(np.floor(places / spacing).astype(np.int64), axis=0, return_index=True)
    return places[np.sort(first)]
