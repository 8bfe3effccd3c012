"""A laser scanner that also tells how much light came back."""

import numpy as np
from jaxtyping import Float, Int

from ..core.config import config


@config
class Reflectance:
    """Light that returns: `gain (rho c^exponent + specular c^shine) / (1 + (r / falloff)^2)`, c = cos(incidence).

    Of a law that was fitted to a real scanner: what white paint hit squarely returns from each of `ranges`, between
    them by their logarithms and outside as at the ends, in place of `gain` and `falloff`.
    """

    gain: float = 40000.0  # intensity of white paint hit squarely from nearby
    falloff: float = 1.5  # [m] at which the light has halved
    exponent: float = 1.0  # of the cosine of incidence
    specular: float = 0.0  # share of light from surfaces hit squarely
    shine: float = 30.0  # exponent of the cosine for that share
    relative_noise: float = 0.03  # standard deviation, as a share of the intensity
    noise: float = 50.0  # standard deviation of the intensity, at least
    ranges: tuple[float, ...] = ()  # [m]
    light: tuple[float, ...] = ()  # at these, whole numbers as the scanner says them
    beams: float = 0.0  # [log units] sd of the gain that each beam has of its own, which
    beams_alike: float = 6.0  # [degrees] neighbours share
    least: float = 0.0  # weaker light is no return
    most: float = np.inf  # stronger light counts as this

    def from_white(self, r: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m n"]:
        """What white paint hit squarely returns from ranges r [m]."""
        if self.ranges:
            return np.asarray(np.exp(np.interp(np.log(r), np.log(self.ranges), np.log(self.light))))
        return np.asarray(self.gain / (1.0 + (r / self.falloff) ** 2))


SECOND_LAW = Reflectance(falloff=2.6, exponent=0.6, specular=0.25)
FITTED = (0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)  # [m] at which laws of real scanners are held
LDS01 = Reflectance(
    exponent=0.16,
    relative_noise=0.091,
    noise=0.0,
    ranges=FITTED,
    light=(14000.0, 12000.0, 8500.0, 6100.0, 4600.0, 3800.0, 2400.0, 1300.0, 910.0, 790.0, 680.0),
    beams=0.007,
    least=51.0,
    most=22606.0,
)
"""LDS-01 of a TurtleBot3: the median of four logs. `benchmarks/light_laws.py` fits this law and the next."""
NEATO = Reflectance(
    exponent=1.08,
    relative_noise=0.0,
    noise=0.0,
    ranges=FITTED,
    light=(2600.0, 2600.0, 1200.0, 640.0, 330.0, 140.0, 52.0, 27.0, 20.0, 16.0, 16.0),
    beams=0.193,
    least=10.0,
    most=1858.0,
)
"""Neato XV-11, of one log: what a place returns differs by what hangs on the beam that meets it."""
LAWS = {"spec": Reflectance(), "second": SECOND_LAW, "lds01": LDS01, "neato": NEATO}


@config
class Scanner:
    """URG-04LX as in its data sheet, every second step."""

    beams: int = 342  # of one revolution
    opening: float = np.radians(240.0)  # [rad] from the first beam to the last
    near: float = 0.02  # [m] nearest range measured
    far: float = 5.6  # [m] farthest range measured
    noise: float = 0.005  # [m], at least
    relative_noise: float = 0.01  # standard deviation, as a share of the range
    step: float = 0.001  # [m] ranges are rounded to

    def angles(self) -> Float[np.ndarray, " n"]:
        """Beam directions as a receiver of the message works them out (32-bit first beam and step)."""
        return np.asarray(self.angle_min + self.angle_increment * np.arange(self.beams))

    @property
    def angle_min(self) -> float:
        return float(np.float32(-0.5 * self.opening))

    @property
    def angle_increment(self) -> float:
        return float(np.float32(self.opening / (self.beams - 1)))

    @property
    def range_max(self) -> float:
        return float(np.float32(self.far))


def measure(
    true_range: Float[np.ndarray, "m n"],
    what: Int[np.ndarray, "m n"],
    cosine: Float[np.ndarray, "m n"],
    reflectance: Float[np.ndarray, "m n"],
    scanner: Scanner,
    law: Reflectance,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """Ranges [m] and intensities as the scanner says them, 32-bit numbers; a range of `range_max` is no return."""
    shape = true_range.shape
    noise = rng.standard_normal((3, *shape))
    seen = what >= 0
    r = np.where(seen, true_range, scanner.far)
    sigma = np.maximum(scanner.noise, scanner.relative_noise * r)
    said = np.round((r + sigma * noise[0]) / scanner.step) * scanner.step
    light = law.from_white(r) * (reflectance * cosine**law.exponent + law.specular * cosine**law.shine)
    if law.beams > 0.0:
        light = light * np.exp(law.beams * _alike(shape[1], law.beams_alike / np.degrees(scanner.angle_increment), rng))
    light = np.maximum(0.0, light * (1.0 + law.relative_noise * noise[1]) + law.noise * noise[2])
    said = said.astype(np.float32).astype(float)
    seen &= (said > scanner.near) & (said < scanner.range_max) & (light >= law.least)
    light = np.minimum(light, law.most)
    return np.where(seen, said, scanner.range_max), np.where(seen, np.round(light), 0.0)


def _alike(n: int, width: float, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Numbers of unit variance, alike within `width` of each other and independent farther apart."""
    half = max(1, round(width))
    bell = np.exp(-0.5 * (np.arange(-2 * half, 2 * half + 1) / (0.5 * half)) ** 2)
    drawn = np.convolve(rng.standard_normal(n + len(bell) - 1), bell, "valid")
    return np.asarray(drawn / np.sqrt(np.square(bell).sum()))
