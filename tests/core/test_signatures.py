"""Texts of signatures: short names, a parameter a line."""

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

from mapweave.core.signatures import COMMON, ReadableSignature, readable, short_default, short_name, with_common
from mapweave.core.workers import Progress, no_progress


def test_names_in_an_annotation_lose_their_modules_and_text_in_quotes_stays():
    assert short_name(Mapping[str, Any] | Path | None) == "Mapping[str, Any] | Path | None"
    assert short_name(Progress) == "Progress"
    assert short_name(Callable[[str, int], None]) == "Callable[[str, int], None]"
    assert short_name(Literal["a.b", "c"]) == "Literal['a.b', 'c']"
    assert short_name("Figure") == "Figure"
    assert short_name(tuple[Path, ...]) == "tuple[Path, ...]"


def test_a_default_is_told_by_its_name_or_by_its_type_where_its_text_is_long():
    assert short_default(no_progress) == "no_progress"
    assert short_default(Path) == "Path"
    assert short_default("a.b") == "'a.b'"
    assert short_default(list(range(100))) == "list(...)"


def made(function):
    """`function`, as if it came from mapweave, with a readable signature."""
    function.__module__ = "mapweave.somewhere"
    readable(function)
    return function


def test_every_kind_of_parameter_is_written_as_python_writes_it():
    def all_kinds(a: int, /, b: float = 1.0, *c: Path, d: str = "x", **e: Path) -> Path: ...
    def keywords(b: int, *, a=2) -> None: ...
    def plain(): ...

    assert str(inspect.signature(made(all_kinds))) == (
        "(a: int, /, b: float = 1.0, *c: Path, d: str = 'x', **e: Path) -> Path"
    )
    assert str(inspect.signature(made(keywords))) == "(b: int, *, a=2) -> None"
    assert str(inspect.signature(made(plain))) == "()"


def test_a_long_signature_has_a_line_for_every_parameter_however_it_is_asked_for():
    def long(first: Mapping[str, Path] | None, *, second: Mapping[str, Path] | None = None, third: int = 3) -> Path: ...

    text = (
        "(\n    first: Mapping[str, Path] | None,\n    *,\n    second: Mapping[str, Path] | None = None,\n"
        "    third: int = 3,\n) -> Path"
    )
    told = inspect.signature(made(long))
    assert str(told) == text
    assert told.format(max_width=10) == text


def test_a_part_of_a_readable_signature_is_readable_and_what_is_not_ours_stays():
    def add(self, path: Path, count: int = 2) -> Path: ...

    kind = type("Kind", (), {"add": made(add), "__module__": "mapweave.somewhere"})
    readable(kind)
    assert str(inspect.signature(kind().add)) == "(path: Path, count: int = 2) -> Path"
    assert str(inspect.signature(partial(add, None, count=3))) == "(path: Path, *, count: int = 3) -> Path"

    def foreign(path: Path): ...

    readable(foreign)
    assert not isinstance(inspect.signature(foreign), ReadableSignature)


def test_what_a_readable_class_holds_is_readable_too():
    def weigh(self, path: Path) -> Path: ...

    weigh.__module__ = "mapweave.somewhere"
    part = type("Part", (), {"weigh": weigh, "__module__": "mapweave.somewhere"})
    hints = {"parts": tuple[part, ...] | None, "path": Path}
    readable(type("Whole", (), {"__annotations__": hints, "__module__": "mapweave.somewhere"}))
    assert str(inspect.signature(weigh)) == "(self, path: Path) -> Path"


def test_what_an_argument_means_for_every_verb_is_added_in_the_order_of_the_arguments_and_never_in_place_of_its_own():
    own = """Done.

    Parameters
    ----------
    out
        Nowhere,
        or here.
    wide
        How wide.

    Raises
    ------
    UsageError
        Never.
    """
    told = with_common(own, ("wide", "seed", "out", "force"))
    names = [line for line in told.split("Raises")[0].splitlines()[4:] if line[:1].strip()]
    assert names == ["wide", "seed", "out", "force"]
    assert "Nowhere,\n    or here.\nforce\n" in told
    assert COMMON["seed"] in told
    assert COMMON["out"] not in told
    assert told.endswith("UsageError\n    Never.")
    assert with_common("Done.", ("out",)) == "Done."
