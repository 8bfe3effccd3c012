"""Systematic resampling: who lives, who dies, whose map the dead take over."""

import numpy as np

from .._jit import kernel


@kernel
def systematic(weights: np.ndarray, u: float) -> np.ndarray:
    """Ancestors (n,) drawn by one number `u` in [0, 1): particle i is drawn floor or ceil of n w_i times.

    weights: (n,) >= 0, any sum > 0. Survivors keep their own place: where i lives, ancestors[i] = i.
    """
    n = weights.shape[0]
    total = 0.0
    for i in range(n):
        total += weights[i]
    count = np.zeros(n, np.int64)
    sum_to, drawn = 0.0, 0
    for i in range(n):
        sum_to += weights[i] / total * n
        while drawn < n and drawn + u < sum_to:
            count[i] += 1
            drawn += 1
    k = n - 1
    while drawn < n:  # rounding left some undrawn: the last particle of any weight takes them
        while k > 0 and not weights[k] > 0.0:
            k -= 1
        count[k] += 1
        drawn += 1
    ancestors = np.empty(n, np.int64)
    parent = 0
    for i in range(n):
        if count[i] > 0:
            ancestors[i] = i
            continue
        while count[parent] < 2:
            parent += 1
        ancestors[i] = parent
        count[parent] -= 1
    return ancestors
