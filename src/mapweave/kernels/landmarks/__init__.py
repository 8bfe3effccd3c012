"""Kernels of landmark SLAM: the EKF over a whole log, submaps."""
