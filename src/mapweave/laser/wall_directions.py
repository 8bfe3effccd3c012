"""The directions in which walls face, as a spectrum: two tell by which turns a scan or submap fits another."""

import numpy as np
from jaxtyping import Complex, Float

BINS = 360  # directions
SMOOTH = 2.0  # [bins] by which they are smoothed
_AWAY = np.minimum(np.arange(BINS), BINS - np.arange(BINS))
_SMOOTHING = np.fft.rfft(np.exp(-0.5 * np.square(_AWAY / SMOOTH)))


def spectrum(amount: Float[np.ndarray, " bins"]) -> Complex[np.ndarray, " f"]:
    """Of how much wall faces each direction, smoothed, the mean off."""
    out = np.fft.rfft(amount) * _SMOOTHING
    out[0] = 0.0
    return np.asarray(out)
