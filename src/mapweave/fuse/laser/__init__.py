"""Laser SLAM by a team of robots: `LaserTeam`, the estimator of exploration in laser worlds."""

from .closures import Closure
from .config import ClosureConfig, LaserTeamConfig, StepNoise
from .team import LaserTeam

__all__ = ["Closure", "ClosureConfig", "LaserTeam", "LaserTeamConfig", "StepNoise"]
