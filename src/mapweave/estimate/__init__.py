"""Estimators: plain functions ``init`` and ``step`` on immutable state, one robot each."""
