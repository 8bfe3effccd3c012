"""Who hangs together with whom, and how the part that nothing fixes is held."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from .network import Network

EXACT_DISTANCE = 1e-4  # an exact distance is held to this many bearing standard deviations of itself


@dataclass(frozen=True, slots=True)
class Components:
    """label: (n,) by connected piece; known: (c,) anchors at distinct places in each; reference: the piece reported."""

    label: Int[np.ndarray, " n"]
    known: Int[np.ndarray, " c"]
    measured: np.ndarray  # (c,) bool: a distance is known in it
    reference: int

    @property
    def anchored(self) -> bool:
        """Whether anchors give place and scale somewhere, so that there is no gauge to choose."""
        return bool((self.known >= 2).any() or ((self.known == 1) & self.measured).any())

    def fixed(self, c: int) -> bool:
        """Whether piece `c` has place and scale from anchors and distances."""
        return bool(self.known[c] >= 2 or (self.known[c] == 1 and self.measured[c]))


def components(net: Network) -> Components:
    """The pieces of the network; the reference has sightings, most anchors (2 count as many), and is largest."""
    n = len(net)
    i = np.concatenate([net.observer, np.array([d.i for d in net.distances], dtype=np.intp)])
    j = np.concatenate([net.target, np.array([d.j for d in net.distances], dtype=np.intp)])
    count, label = connected_components(sp.csr_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    known, measured = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
    for c in range(count) if net.anchors else ():
        places = {tuple(p) for k, p in net.anchors.items() if label[k] == c}
        known[c] = len(places)
    for d in net.distances:
        measured[label[d.i]] = True
    size = np.bincount(label, minlength=count)
    worth = np.minimum(known + (measured & (known > 0)), 2)
    seen = np.bincount(label[net.observer], minlength=count) > 0
    reference = int(np.lexsort((size, worth, seen))[-1]) if count else 0
    return Components(label, known, measured, reference)


def effective_sigma(net: Network) -> Float[np.ndarray, " m"]:
    """Standard deviations to weigh by: exact sightings (all zero) weigh alike, as with R = I."""
    return net.sigma if np.any(net.sigma > 0) else np.ones(len(net.sigma))
