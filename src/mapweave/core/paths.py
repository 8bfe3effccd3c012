"""Arguments that are paths or settings: what is handed over in place of one is refused by name, first of all."""

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from numbers import Integral
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, ParamSpec, Protocol, TypeVar, get_args, get_origin, runtime_checkable

from .errors import UsageError

P = ParamSpec("P")
T = TypeVar("T")


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


def _is_mapping(annotation: object) -> bool:
    """Whether it is a mapping or None, and nothing else."""
    kinds = get_args(annotation)
    return NoneType in kinds and all(kind is NoneType or get_origin(kind) is Mapping for kind in kinds)


def path_arguments(verb: Callable[P, T]) -> Callable[P, T]:
    """`verb` raises UsageError for anything but a path where its annotation is `Path | str`, or that and None.

    So it does for anything but settings where it is `AnyConfig | None`, but a mapping where it is one or None, but a
    whole number where it is `int`.
    """
    parameters = inspect.signature(verb).parameters
    names = tuple(parameters)
    wanted: dict[str, bool] = {}
    settings = {name for name, parameter in parameters.items() if parameter.annotation == AnyConfig | None}
    whole = {name for name, parameter in parameters.items() if parameter.annotation is int}
    mappings = {name for name, parameter in parameters.items() if _is_mapping(parameter.annotation)}
    for name, parameter in parameters.items():
        kinds = get_args(parameter.annotation)
        if Path in kinds and all(kind in (Path, str, NoneType) for kind in kinds):
            wanted[name] = NoneType in kinds

    @wraps(verb)
    def checked(*args: P.args, **options: P.kwargs) -> T:
        for name, given in (*zip(names, args, strict=False), *options.items()):
            if name in wanted and not (given is None and wanted[name]):
                path_of(given, name)
            if name in settings and not isinstance(given, (str, PathLike, Mapping, IsConfig, NoneType)):
                raise UsageError(
                    f"{name}: expected a TOML file, its tables or an object of settings, found {kind_of(given)}"
                )
            if name in whole and not isinstance(given, Integral):
                raise UsageError(f"{name}: expected a whole number, found {kind_of(given)}")
            if name in mappings and not isinstance(given, (Mapping, NoneType)):
                raise UsageError(f"{name}: expected a mapping, found {kind_of(given)}")
        return verb(*args, **options)

    return checked
