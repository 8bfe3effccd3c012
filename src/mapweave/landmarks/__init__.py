"""Landmark SLAM of one robot: EKF-SLAM, local maps and submaps, data association."""
