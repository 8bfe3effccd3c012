"""A laser scanner that also tells how much light came back."""

import numpy as np
from jaxtyping import Float, Int

from ..core.config import config


@config
class Reflectance:
    """Light that returns: `gain (rho c^exponent + specular c^shine) / (1 + (r / falloff)^2)`, c = cos(incidence)."""

    gain: float = 40000.0  # intensity of white paint hit squarely from nearby
    falloff: float = 1.5  # [m] at which the light has halved
    exponent: float = 1.0  # of the cosine of incidence
    specular: float = 0.0  # share of light from surfaces hit squarely
    shine: float = 30.0  # exponent of the cosine for that share
    relative_noise: float = 0.03  # standard deviation, as a share of the intensity
    noise: float = 50.0  # standard deviation of the intensity, at least


SECOND_LAW = Reflectance(falloff=2.6, exponent=0.6, specular=0.25)


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
    light = law.gain * (reflectance * cosine**law.exponent + law.specular * cosine**law.shine)
    light = light / (1.0 + (r / law.falloff) ** 2)
    light = np.maximum(0.0, light * (1.0 + law.relative_noise * noise[1]) + law.noise * noise[2])
    said = said.astype(np.float32).astype(float)
    seen &= (said > scanner.near) & (said < scanner.range_max)
    return np.where(seen, said, scanner.range_max), np.where(seen, np.round(light), 0.0)
