"""One map from many local maps, and why each was or was not merged."""

from .config import FuseConfig
from .join import fuse
from .known_starts import tie_by_starts
from .online import OnlineFuser
from .result import Component, Decision, Fusion

__all__ = ["Component", "Decision", "FuseConfig", "Fusion", "OnlineFuser", "fuse", "tie_by_starts"]
