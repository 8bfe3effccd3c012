"""Where every robot of a swarm is, from bearings alone. [Hamatani], and beyond it.

``locate(network)`` is the whole of it; the method is a field of the configuration.
"""

import numpy as np

from ...maps.network import Network
from ...maps.swarm import SwarmEstimate
from .batch import batch
from .config import SwarmConfig

__all__ = ["SwarmConfig", "locate"]


def locate(
    net: Network,
    cfg: SwarmConfig | None = None,
    initial: np.ndarray | None = None,
) -> SwarmEstimate:
    """Positions of all robots of `net`, by the method `cfg` names.

    initial: (n, d) [m] first estimate; the filters' start, elsewhere it takes the place of the linear one. Raises
    DataError when there is nothing to work on; what cannot be located is named in the result, never an error.
    """
    cfg = cfg or SwarmConfig()
    return batch(net, cfg, initial)
