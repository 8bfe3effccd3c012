"""Kernels of mapping: a submap searched for in another."""
