"""Kernels of the sparse solver."""
