"""Processes in which runs are made: shapes are not checked there, and they start once for all tests of a session."""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context


@cache
def workers() -> ProcessPoolExecutor:
    """Two; they end with the session."""
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))
