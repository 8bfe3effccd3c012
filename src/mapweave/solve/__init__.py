"""Sparse nonlinear least squares in information form, robust kernels, marginals."""
