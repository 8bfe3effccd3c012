"""Kernels of walls: rays, sight, distances, buckets of segments."""
