"""Ranges between robots, and from robots to beacons: where everybody was, from ranges and odometry alone."""
