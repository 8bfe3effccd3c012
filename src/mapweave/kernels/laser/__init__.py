"""Kernels of laser SLAM: beams, scan matching, tiles of many maps, likelihood fields."""
