"""The checks of shapes and types that run beneath all other tests: what they find, and in which calls."""

import os
from dataclasses import dataclass

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float

from . import typecheck


@pytest.fixture(scope="module")
def checked():
    return typecheck.jaxtyped(typechecker=typecheck.checked)


def wrong(n: int, call) -> list[int]:
    """Which of `n` calls are found to be wrong."""
    found = []
    for k in range(1, n + 1):
        try:
            call()
        except BeartypeCallHintViolation:
            found.append(k)
    return found


def doubled(x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return 2 * x


def shortened(x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return x[1:]


def test_arguments_and_results_of_the_wrong_shape_are_found(checked):
    assert checked(doubled)(np.ones((3, 2))).shape == (3, 2)
    with pytest.raises(BeartypeCallHintViolation, match="doubled"):
        checked(doubled)(np.ones((2, 3)))
    with pytest.raises(BeartypeCallHintViolation, match="return"):
        checked(shortened)(np.ones((3, 2)))


def test_names_that_type_checkers_alone_know_stand_for_anything_and_the_rest_is_checked(checked):
    @checked
    def drawn(on: "Axes", by: "np.Pen", x: "Float[np.ndarray, ' n']") -> None: ...

    drawn("anything", "at all", np.ones(2))
    with pytest.raises(BeartypeCallHintViolation):
        drawn("anything", "at all", np.ones((2, 2)))


def test_the_first_calls_of_a_test_are_checked_and_one_in_so_many_after(checked):
    call, rows = checked(doubled), np.ones((2, 3))
    first = list(range(1, typecheck.FIRST + 1))
    assert wrong(150, lambda: call(rows)) == [*first, typecheck.EVERY, 2 * typecheck.EVERY]
    typecheck.begin()
    assert wrong(40, lambda: call(rows)) == first


def test_functions_within_functions_are_counted_together_however_often_they_are_defined(checked):
    def outer():
        @checked
        def inner(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
            return x

        return inner(np.ones((2, 2)))

    first = list(range(1, typecheck.FIRST_NESTED + 1))
    assert wrong(1000, outer) == [*first, typecheck.EVERY_NESTED]


def test_fields_of_a_dataclass_are_checked_and_ints_stand_for_floats(checked):
    @checked
    @dataclass(frozen=True, slots=True)
    class Point:
        x: Float[np.ndarray, "2"]
        weight: float

    assert Point(np.ones(2), 1).weight == 1
    with pytest.raises(BeartypeCallHintViolation):
        Point(np.ones(3), 1.0)
    with pytest.raises(BeartypeCallHintViolation):
        Point(np.ones(2), "1")


@pytest.mark.skipif(os.environ.get("MAPWEAVE_TYPECHECK", "1") != "1", reason="shapes are not checked in this run")
def test_the_house_is_checked_while_tests_run():
    from mapweave.core import se2

    with pytest.raises(BeartypeCallHintViolation):
        se2.between(np.zeros(4), np.zeros(3))
