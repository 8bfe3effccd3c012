"""Laser SLAM: beams, scan matching, particle filter, pose graph, closures, occupancy, localisation."""
