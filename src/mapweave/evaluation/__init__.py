"""Errors and consistency against truth, every score once; no estimator imports this room."""
