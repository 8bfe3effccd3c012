"""How a team is smoothed while its logs play."""

from ..core.config import config
from ..core.errors import ConfigError


@config
class OnlineConfig:
    """The table `[online]` of a landmark configuration."""

    step: float = 1.0  # [s] of the logs that are taken in at once
    stretch: float = 10.0  # [s] of a stretch, whose poses are eliminated together
    window: int = 2  # stretches, the latest, that are linearised anew at every step
    move: float = 0.02  # [m], [rad] from which an older stretch is linearised anew when it has moved
    renewed: int = 3  # older stretches that are linearised anew in one step, at most, those that moved most first
    iterations: int = 3  # of Gauss-Newton in a step, at most
    still: float = 0.002  # [m], [rad] of change at which a step ends
    fuse_every: float = 10.0  # [s] between two looks at which robots and landmarks hang together
    settle: int = 15  # iterations over everything when a robot has come in, at most

    def __post_init__(self) -> None:
        for name in ("step", "stretch", "fuse_every", "move", "still"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a number above 0, found {getattr(self, name)}")
        for name in ("window", "iterations", "settle"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}: expected 1 or more, found {getattr(self, name)}")
        if self.stretch < self.step:
            raise ConfigError(f"stretch: expected as long as a step ({self.step} s) or longer, found {self.stretch}")
