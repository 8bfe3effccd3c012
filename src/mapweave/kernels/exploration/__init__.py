"""Kernels of exploration: objectives, tours, laps, paths through a grid."""
