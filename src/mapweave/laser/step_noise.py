"""How far a keyframe's step may err, from what the walls and the wheels tell together."""

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.gaussian import symmetrise


@config
class StepNoise:
    """How far a keyframe's step may err: what the lines of the scan and the wheels tell together, and drift.

    Squares grow with the way. A scan's place is told by lines and wheels; its heading is held by long walls, so that
    what one scan errs does not add up: it is jitter, which every keyframe has once and no step inherits.
    """

    wheels_xy: float = 0.033  # [m per sqrt(m)] sd of odometry, whose scale errs for metres on end
    wheels_turn_per_m: float = 0.0075  # [rad per sqrt(m)] sd of odometry's heading with the way
    wheels_turn: float = 0.018  # [rad per sqrt(rad)] and with the turning
    trust: float = 2.0  # [-] what one scan's information on its place counts, its returns not being independent
    blur: float = 0.02  # [-] share of the information across lines that noise in their normals feigns along them
    hold: float = 100.0  # [-] headings: how many scans' information a step counts, jitter not adding up
    drift_xy: float = 0.002  # [m per sqrt(m)] that the front end drifts where walls tell all
    drift_turn: float = 0.0003  # [rad per sqrt(m)] that its heading drifts
    jitter_xy: float = 0.002  # [m] sd of every keyframe's place, which no step inherits
    jitter_turn: float = 0.001  # [rad] sd of its heading


def carried(cov: Float[np.ndarray, "3 3"], step: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A covariance in the frame before `step`, seen in the frame after it (a later pose errs by turns before)."""
    c, s = np.cos(step[2]), np.sin(step[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    J = R @ np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
    return np.asarray(J @ cov @ J.T)


def wheel_noise(step: Float[np.ndarray, "3"], noise: StepNoise) -> Float[np.ndarray, "3 3"]:
    """Covariance of one odometry increment."""
    d, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
    xy = noise.wheels_xy**2 * d + 1e-8
    return np.diag([xy, xy, noise.wheels_turn_per_m**2 * d + noise.wheels_turn**2 * turn + 1e-8])


def believed(lines: Float[np.ndarray, "3 3"], trust: float, blur: float) -> Float[np.ndarray, "3 3"]:
    """Information of lines less what noise in their normals alone gives, positive semidefinite, times `trust`.

    Lines whose normals scatter by chance seem to tell something along themselves: `blur` times what they tell across.
    """
    scatter = 0.5 * blur * (lines[0, 0] + lines[1, 1])
    values, vectors = np.linalg.eigh(lines[:2, :2])
    kept = np.maximum(values - scatter, 0.0) / np.maximum(values, 1e-12)
    T = np.eye(3)
    T[:2, :2] = vectors @ np.diag(np.sqrt(kept)) @ vectors.T
    return symmetrise(trust * (T @ lines @ T))


def step_covariance(
    lines: Float[np.ndarray, "3 3"], wheels: Float[np.ndarray, "3 3"], way: float, noise: StepNoise
) -> Float[np.ndarray, "3 3"]:
    """Covariance of a keyframe's step over `way` [m], without the jitter of its ends."""
    place = believed(lines, noise.trust, noise.blur)[:2, :2] + np.linalg.inv(wheels[:2, :2] + 1e-10 * np.eye(2))
    cov = np.zeros((3, 3))
    cov[:2, :2] = symmetrise(np.linalg.inv(place)) + (noise.drift_xy**2 * way + 1e-8) * np.eye(2)
    cov[2, 2] = 1.0 / (noise.hold * lines[2, 2] + 1.0 / (wheels[2, 2] + 1e-10)) + noise.drift_turn**2 * way + 1e-10
    return cov
