"""What the wheels of a log are worth, learned while it is mapped from steps where walls hold every direction.

Poor wheels hold a robot nowhere; good ones hold it along a corridor in which scans tell little, over a pause, and
against rooms that look alike.
"""

import math
from bisect import insort
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ..core import se2

HOLDS = 0.1  # of what all returns could tell of a place across a wall, from which a direction is held
DRIVES, TURNS = 0.02, 0.03  # [m], [rad] of a step that tells what wheels are worth
WINDOW, WINDOW_TURN = 1.0, 0.5  # [m] of way or [rad] of turning over which steps are summed
ANY = 4.0  # steps of any wheels that stand against those seen
WILD = 3.0  # standard deviations at most that one step counts
STEP_WIDE = 1.5  # times what steps tell, whose errors have tails
CAREFUL = 1.5  # times what windows tell, errors over longer ways being alike
LEAST, MOST = 0.2, 1.0  # of what any wheels may err by, that these are believed to
PROVEN = 0.5  # of what any wheels may err by over longer ways, under which they are better than matches of few returns
SELDOM = 0.25  # of the steps in narrow views: where fewer are held in every direction, the median of all counts
MEDIAN = 0.6745  # of the size of a number that is normal with sd 1
FEW = (0.5, 0.65)  # shares of the returns that match, which part scans in those of few matches, of some and of many


class Spread:
    """The spread of numbers that are seen, begun as if some of 1 had been. `see` changes it."""

    def __init__(self) -> None:
        self.n, self.squares, self.most = ANY, ANY, 0.0

    def see(self, z: float) -> None:
        """One more number."""
        self.n += 1.0
        self.squares += min(z, WILD) ** 2
        self.most = max(self.most, z)

    def of(self, careful: float) -> float:
        """Their standard deviation, `careful` times, within what is believed of any wheels."""
        return float(np.clip(careful * np.sqrt(self.squares / self.n), LEAST, MOST))


class Median:
    """As `Spread`, by the median size of the numbers: a few that are wrong, however wrong, hardly change it."""

    def __init__(self) -> None:
        self.sizes = [MEDIAN] * int(ANY)

    def see(self, z: float) -> None:
        """One more number."""
        insort(self.sizes, z)

    def of(self, careful: float) -> float:
        """The standard deviation that it tells of numbers that are normal, else as `Spread`."""
        return float(np.clip(careful * self.sizes[len(self.sizes) // 2] / MEDIAN, LEAST, MOST))


def _least_held(lines: Float[np.ndarray, "3 3"]) -> float:
    """How much the direction is held of which `lines` tell least, headings being free."""
    (a, b, u), (_, c, v), (_, _, w) = lines.tolist()
    a, b, c = (one - two / max(w, 1e-9) for one, two in ((a, u * u), (b, u * v), (c, v * v)))
    return float(0.5 * (a + c) - math.hypot(0.5 * (a - c), b))


class WheelWorth:
    """What is known of one robot's wheels so far. `see` changes it.

    noise: covariance (3, 3) of a step of any wheels, over x, y, theta; narrow: whether the scanner's view is.
    """

    def __init__(self, noise: Callable[[Float[np.ndarray, "3"]], Float[np.ndarray, "3 3"]]) -> None:
        self._noise, self.narrow = noise, False
        self._step, self._step_turn, self._way, self._turn = Spread(), Spread(), Spread(), Spread()
        self._any = Median(), Median(), Median()  # of all steps, held or not: ahead, aside, turn
        self._off = [(Spread(), Spread()) for _ in range(len(FEW) + 1)]  # of places and headings, by share
        self.interrupted()

    def interrupted(self) -> None:
        """A step came of which scans and wheels do not tell together."""
        self._wheels, self._scans, self._cov = np.zeros(3), np.zeros(3), np.zeros((3, 3))
        self._far = np.zeros(2)

    @property
    def step(self) -> Float[np.ndarray, "3"]:
        """What a step may err by in x, y, theta, over what that of any wheels may."""
        if self.narrow and self._step.n < SELDOM * len(self._any[0].sizes):
            return np.array([median.of(STEP_WIDE) for median in self._any])
        xy, turn = self._step.of(STEP_WIDE), self._step_turn
        return np.array([xy, xy, min(max(turn.of(STEP_WIDE), turn.most), MOST)])  # wheels that slipped will slip again

    def scaled(self, cov: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The covariance of a way as any wheels tell it, over x, y, theta, for these."""
        xy = self._way.of(CAREFUL)
        f = np.array([xy, xy, self._turn.of(CAREFUL)])
        return np.asarray(cov * f[:, None] * f)

    @property
    def proven(self) -> bool:
        """Whether over longer ways they are better than matches of few returns."""
        return max(self._way.of(CAREFUL), self._turn.of(CAREFUL)) < PROVEN

    def few(
        self,
        share: float,
        wheels: Float[np.ndarray, "3"],
        innovation: Float[np.ndarray, "3"],
        sd: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, "3"]:
        """How far from where `wheels` put it a scan is, of whose returns this share match elsewhere, by `innovation`.

        Where few match, as among leaves, they lie farther from where wheels say than where many do: so much the less
        they are believed, if over longer ways the wheels have proven good. Bad ones are why few match. sd: as of `see`.
        """
        of = self._off[int(np.searchsorted(FEW, share, side="right"))]
        if np.hypot(wheels[0], wheels[1]) > DRIVES or abs(wheels[2]) > TURNS:
            of[0].see(float(np.hypot(innovation[0], innovation[1]) / (np.sqrt(2.0) * sd[0])))
            of[1].see(float(abs(innovation[2]) / sd[2]))
        if of is self._off[-1] or not self.proven:
            return innovation
        xy, turn = (
            min(1.0, many.squares / many.n * few.n / few.squares) for many, few in zip(self._off[-1], of, strict=True)
        )
        return innovation * [xy, xy, turn]

    def see(
        self,
        wheels: Float[np.ndarray, "3"],
        innovation: Float[np.ndarray, "3"],
        sd: Float[np.ndarray, "3"],
        lines: Float[np.ndarray, "3 3"],
        whole: float,
    ) -> None:
        """A step of `wheels`, and by how much the scan's match lies elsewhere; sd: what those of any may err by.

        lines: what walls tell of the pose, over x, y, theta; whole: what all returns across one wall would [1/m^2].
        """
        moved = np.array([np.hypot(wheels[0], wheels[1]), abs(wheels[2])])
        moves = moved[0] > DRIVES or moved[1] > TURNS
        if moves:  # a heading is told by any wall
            self._step_turn.see(float(abs(innovation[2]) / sd[2]))
            for median, z in zip(self._any, np.abs(innovation) / sd, strict=True):
                median.see(float(z))
        if _least_held(lines) < HOLDS * whole:
            self.interrupted()
            return
        if moves:
            self._step.see(float(np.hypot(innovation[0], innovation[1]) / (np.sqrt(2.0) * sd[0])))
        matched = se2.compose(wheels, innovation)
        self._wheels, self._scans = se2.compose(self._wheels, wheels), se2.compose(self._scans, matched)
        c, s = np.cos(matched[2]), np.sin(matched[2])
        J = np.array([[c, s, matched[0] * s - matched[1] * c], [-s, c, matched[0] * c + matched[1] * s], [0, 0, 1]])
        self._cov = J @ self._cov @ J.T + self._noise(matched)
        self._far += moved
        if (self._far < [WINDOW, WINDOW_TURN]).all():
            return
        e, v = se2.between(self._wheels, self._scans), np.diag(self._cov)
        self._way.see(float(np.hypot(e[0], e[1]) / np.sqrt(v[0] + v[1])))
        self._turn.see(float(abs(e[2]) / np.sqrt(v[2])))
        self.interrupted()
