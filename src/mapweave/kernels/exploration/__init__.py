"""Kernels of exploration: objectives, tours, laps, ways through a grid."""
