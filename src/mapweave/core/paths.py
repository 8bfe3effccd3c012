"""The door of verbs: arguments are checked by name, `~` is the home folder, what files refuse is told as all else."""

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from difflib import get_close_matches
from functools import wraps
from numbers import Integral, Real
from operator import is_
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, ParamSpec, Protocol, TypeVar, Union, get_args, get_origin, runtime_checkable

from .errors import MapweaveError, UsageError
from .signatures import with_common
from .workers import Progress

P = ParamSpec("P")
T = TypeVar("T")
PACKAGE = f"{__name__.partition('.')[0]}."


@runtime_checkable
class IsConfig(Protocol):
    """An object of a configuration class."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


AnyConfig = Path | str | Mapping[str, Any] | IsConfig
"""What a verb takes as `config`: a TOML file, its tables as mappings, or an object: of all settings or of one table."""


def is_path(given: object) -> bool:
    """Whether `given` is text or a path."""
    return isinstance(given, str | PathLike)


def path_of(given: object, name: str, expected: str = "a path") -> Path:
    """The path that was given; raises UsageError for what is none. name: of the argument; expected: in its message."""
    if isinstance(given, str | PathLike):
        return Path(given)
    raise UsageError(f"{name}: expected {expected}, found {kind_of(given)}")


def kind_of(given: object) -> str:
    """What `given` is, for a message: its type's name, None itself."""
    return "None" if given is None else type(given).__name__


# what an annotation may be made of: the kind that is taken for it, and what a message calls it
PLAIN: dict[object, tuple[type, str]] = {
    Path: (PathLike, "a path"),
    str: (str, "text"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
    bool: (Integral, "True or False"),
    Mapping: (Mapping, "a mapping"),
    Sequence: (Iterable, "a sequence"),
    Progress: (Callable, "a function"),  # type: ignore[dict-item]
    Callable: (Callable, "a function"),  # type: ignore[dict-item]
}
NO_SEQUENCE = (str, bytes, Mapping)  # letters, numbers or keys one by one are not what was meant
VOWELS = "AEIO"  # as names of classes begin
TRUTHS = {"bool", "bool_"}  # the kinds of truth values, NumPy's too


@dataclass(frozen=True, slots=True)
class _Expected:
    """What a parameter takes, of an annotation that is made of plain kinds and of classes of this package alone."""

    kinds: tuple[type, ...]
    words: str
    sequence: bool
    truth: bool

    @classmethod
    def of(cls, annotation: object) -> "_Expected | None":
        """None for an annotation with other parts, which the verb looks at itself."""
        if annotation == AnyConfig | None:
            kinds = (str, PathLike, Mapping, IsConfig, NoneType)
            return cls(kinds, "a TOML file, its tables or an object of settings", sequence=False, truth=False)
        union = get_origin(annotation) in {Union, UnionType}
        given = get_args(annotation) if union else (annotation,)
        parts = [part if get_origin(part) is Literal else get_origin(part) or part for part in given]
        taken: list[type] = []
        words: list[str] = []
        for part in parts:
            if get_origin(part) is Literal:  # which of them it is the verb looks at itself
                taken += [PLAIN[type(value)][0] for value in get_args(part)]
                words += map(str, get_args(part))
                continue
            if part is NoneType:
                taken.append(NoneType)
            elif part in PLAIN:
                taken.append(PLAIN[part][0])
                words.append(PLAIN[part][1])
            elif isinstance(part, type) and is_dataclass(part) and part.__module__.startswith(PACKAGE):
                taken.append(part)
                words.append(f"{'an' if part.__name__[0] in VOWELS else 'a'} {part.__name__}")
            else:
                return None
        held = {part for part in parts if part is not NoneType}
        if held == {Path, str}:
            words = ["a path"]
        elif held & {Path, Mapping, Sequence} and len(held) > 1:  # data, as paths or in memory
            return None
        return cls(tuple(taken), " or ".join(words), sequence=Sequence in held, truth=bool in held)

    def takes(self, given: object) -> bool:
        if self.sequence and isinstance(given, NO_SEQUENCE):
            return False
        if kind_of(given) in TRUTHS:  # no number
            return self.truth
        return isinstance(given, self.kinds)


def _told_instead(name: str, each: Mapping[str, "_Expected | None"]) -> str:
    """In words, which object of options has one of that name, else which names are like it."""
    for own, expected in each.items():
        for kind in () if expected is None else expected.kinds:
            if name in getattr(kind, "__dataclass_fields__", {}):
                return f": give {own}={kind.__name__}({name}=...)"
    like = get_close_matches(name, each)
    return f": did you mean {' or '.join(like)}?" if like else f", expected one of {', '.join(each)}"


def holds_paths(annotation: object) -> bool:
    """Whether what is so annotated may be a path, several, or options one of which is a path."""
    parts = (annotation, *get_args(annotation))
    return Path in parts or any(map(holds_paths, parts[1:])) or any(map(_paths_in, parts))


def _paths_in(options: object) -> list[str]:
    """Which fields of an object of options, or of its class, may be paths."""
    return [f.name for f in fields(options) if Path in get_args(f.type)] if is_dataclass(options) else []


def at_home(given: Any, name: str) -> Any:
    """What was given, in which paths that begin with `~` lie in the home folder; raises UsageError for an empty one."""
    if isinstance(given, list | tuple):
        found = [at_home(one, name) for one in given]
        return given if all(map(is_, found, given)) else found
    if isinstance(given, str | PathLike):
        text = os.fspath(given)
        if not text or "\0" in str(text):
            raise UsageError(f"{name}: expected a path, found {text!r}")
        home = os.path.expanduser(text)  # noqa: PTH111  (Path's raises for the name of nobody)
        return given if home == text else home if isinstance(given, str) else Path(home)
    moved = {key: at_home(value, key) for key in _paths_in(given) if (value := getattr(given, key)) is not None}
    return replace(given, **moved) if any(moved[key] is not getattr(given, key) for key in moved) else given


def checked_arguments(verb: Callable[P, T]) -> Callable[P, T]:
    """`verb` raises UsageError by the argument's name for what is of another kind than its annotation says.

    That is asked where the annotation is made of paths, text, numbers, mappings, sequences, functions, settings and
    classes of this package; data that come in many kinds are the verb's own to check. Paths that begin with `~` reach
    it expanded. A file that cannot be read or written is a MapweaveError that names it. What the docstring does not say
    of arguments that mean the same for every verb is added to it.
    """
    parameters = inspect.signature(verb).parameters
    names = tuple(parameters)
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    each = {name: _Expected.of(parameter.annotation) for name, parameter in parameters.items()}
    paths = {name for name, parameter in parameters.items() if holds_paths(parameter.annotation)}

    @wraps(verb)
    def checked(*args: P.args, **options: P.kwargs) -> T:
        for name, given in (*zip(names, args, strict=False), *options.items()):
            expected = each.get(name)
            if name not in parameters and not takes_any:
                raise UsageError(f"{name}: {verb.__name__} has no such option{_told_instead(name, each)}")
            if expected is not None and not expected.takes(given):
                raise UsageError(f"{name}: expected {expected.words}, found {kind_of(given)}")
            if name == "seed" and isinstance(given, Integral) and int(given) < 0:
                raise UsageError(f"--seed: expected 0 or more, found {given}")
        named = [at_home(given, name) if name in paths else given for name, given in zip(names, args, strict=False)]
        options.update({name: at_home(given, name) for name, given in options.items() if name in paths})
        try:
            return verb(*named, *args[len(named) :], **options)  # type: ignore[arg-type]
        except OSError as error:
            if error.filename is None:  # no file: who reads what is printed stopped, or the network
                raise
            told = MapweaveError(f"{error.filename}: {error.strerror}")
            told.__notes__ = getattr(error, "__notes__", [])
            raise told from error

    checked.__doc__ = with_common(verb.__doc__ or "", names) or None
    return checked
