"""Where every robot of a swarm is, from bearings alone. [Hamatani], and beyond it.

``locate(network)`` is the whole of it; the method is a field of the configuration.
"""

import numpy as np

from ..core.errors import DataError
from .batch import batch
from .config import SwarmConfig
from .distributed import distributed
from .filtered import filtered
from .network import BearingNetwork
from .result import SwarmEstimate
from .robust import robust

__all__ = ["SwarmConfig", "locate"]


def locate(
    net: BearingNetwork,
    cfg: SwarmConfig | None = None,
    initial: np.ndarray | None = None,
) -> SwarmEstimate:
    """Positions of all robots of `net`, by the method `cfg` names.

    initial: (n, d) [m] first estimate; the filters' start, elsewhere it takes the place of the linear one. Raises
    DataError when there is nothing to work on; what cannot be located is named in the result, never an error.
    """
    cfg = cfg or SwarmConfig()
    if not len(net.observer):
        raise DataError("no sightings: nothing can be located")
    if cfg.method in {"ekf", "iekf", "fej"}:
        return filtered(net, cfg, cfg.method, initial)
    if cfg.method == "robust":
        return robust(net, cfg, initial)
    if cfg.method == "distributed":
        return distributed(net, cfg, initial)
    return batch(net, cfg, initial)
