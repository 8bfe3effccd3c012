"""Robots that move while they sight each other: positions over time, filtered and smoothed.

The motion is nearly constant velocity, or the robots' own odometry; the sightings are those of robots that stand still.
"""

from .drive import smooth_driving
from .filtering import filtered
from .result import RobotTrack, SwarmTrack, TrackConfig
from .smooth import smooth

__all__ = ["RobotTrack", "SwarmTrack", "TrackConfig", "filtered", "smooth", "smooth_driving"]
