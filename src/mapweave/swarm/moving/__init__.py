"""Robots that move while they sight each other: positions over time, filtered and smoothed.

The motion is nearly constant velocity, or the robots' own odometry; the sightings are those of robots that stand still.
"""
