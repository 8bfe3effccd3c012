"""How shapes and types are checked while tests run: in each test and fixture, a function's first calls and then some.

An int may stand where a float is asked for, as PEP 484 says. A check takes tens of microseconds, many times what most
functions take: checking every call of a filter that runs for a thousand steps finds no more than checking a few dozen.
Which calls are checked depends on the test alone, whatever ran before it.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from types import CodeType, SimpleNamespace
from typing import Any, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype

FIRST, EVERY = 8, 61  # calls of a function in one test that are checked: the first of them, and one in so many after
FIRST_NESTED, EVERY_NESTED = 4, 997  # of one defined within another: each time it is defined, its check is made anew

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
_jaxtyped = jaxtyping.jaxtyped


class _Turn:
    """Which test or fixture is under way."""

    number = 0


_NESTED: dict[CodeType, list[int]] = {}  # counted together however often they are defined


def begin() -> None:
    """From here on every function's first calls are checked again."""
    _Turn.number += 1


def _known(hint: object, plain: Callable) -> object:
    """`hint`, or anything at all where it names what type checkers alone know."""
    alone = SimpleNamespace(__annotations__={"hint": hint})
    try:
        return get_type_hints(alone, plain.__globals__, include_extras=True)["hint"]
    except (NameError, AttributeError):
        return Any


def _checking(plain: Callable, typechecker: Callable) -> Callable:
    """`plain`, which checks what it is given and gives back: letters of shapes stand for one number within a call.

    `jaxtyping.jaxtyped` would check arguments twice, by two functions it makes, for a message that shows them all.
    """
    plain.__annotations__ = {name: _known(hint, plain) for name, hint in plain.__annotations__.items()}
    check = typechecker(plain)

    def call(*args, **kwargs):
        __tracebackhide__ = True
        with _jaxtyped("context"):
            return check(*args, **kwargs)

    return call


def thinned(plain: Callable, typechecker: Callable) -> Callable:
    """`plain`, some calls of which are checked."""
    first, every, seen = FIRST, EVERY, [0, -1]  # calls since the test or fixture began, and which of them it is
    if "<locals>" in getattr(plain, "__qualname__", ""):
        first, every = FIRST_NESTED, EVERY_NESTED
        seen = _NESTED.setdefault(plain.__code__, seen)
    always = None

    @functools.wraps(plain)
    def call(*args, **kwargs):
        __tracebackhide__ = True
        nonlocal always
        if seen[1] != _Turn.number:
            seen[:] = 0, _Turn.number
        seen[0] = number = seen[0] + 1
        if number > first and number % every:
            return plain(*args, **kwargs)
        if always is None:
            always = _checking(plain, typechecker)
        return always(*args, **kwargs)

    return call


def jaxtyped(made=None, *, typechecker=None):
    """Stands in for `jaxtyping.jaxtyped`, which checks every call."""
    if made is None:
        return functools.partial(jaxtyped, typechecker=typechecker)
    if not inspect.isclass(made):
        return thinned(made, typechecker)
    if dataclasses.is_dataclass(made) and "__init__" in vars(made):
        plain = made.__init__
        if plain.__globals__ is not globals():  # not one that was written out, which is checked already
            made.__init__ = thinned(plain, typechecker)
    return made


def install(rooms: list[str]) -> None:
    """Functions and dataclasses of these packages are checked wherever they are imported from now on."""
    jaxtyping.jaxtyped = jaxtyped  # modules under the hook ask for it by this name
    jaxtyping.install_import_hook(rooms, f"{__name__}.checked")
