"""Errors and consistency against truth; no estimator imports this room."""
