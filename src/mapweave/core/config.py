"""Configuration: typed frozen dataclasses, filled from TOML, every mistake told at once.

A config stands beside the code that reads it: ``@config class IcpConfig: max_correspondence: float = 0.5  # [m]``. A
key that has moved is named in the `MOVED` of the outermost class (old: new, dotted); a file with the old is told so.
Numbers that must be above 0 are named in its `POSITIVE`, dotted; those that may be below 0 in the `SIGNED` of their own
class.
One that became a constant is named in `fixed_keys.toml`, and a file that has it is told to leave it out.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, dataclass_transform

from .errors import ConfigError
from .paths import kind_of

T = TypeVar("T")

UNKNOWN = "unexpected_keyword_argument"
_WORDS = {
    UNKNOWN: "unknown key",
    "missing": "missing",
    "tuple_type": "expected a list",
    "string_type": "expected text",
    "int_type": "expected a whole number",
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "int_parsing": "expected a whole number",
    "int_from_float": "expected a whole number",
    "finite_number": "expected a number, found one that is not finite",
}
TINIEST = 1e-6  # of what a number usually is, or of 1: less is a slip; errors of nearly nothing leave nothing to solve
_TYPES = {"str", "int", "float", "bool", "none"}  # how a union's members are called in a place


@dataclass_transform(frozen_default=True, kw_only_default=True)
def config(cls: type[T]) -> type[T]:
    """A frozen, keyword-only dataclass that refuses unknown keys and NaN when it is read from a file."""
    config_class = dataclass(frozen=True, slots=True, kw_only=True)(cls)
    config_class.__pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # type: ignore[attr-defined]
    return config_class


def build(cls: type[T], values: dict[str, Any], where: str = "configuration") -> T:
    """`cls` from nested `values`; raises ConfigError that lists every unknown key and bad value."""
    from pydantic import TypeAdapter, ValidationError  # noqa: PLC0415  (costs 0.1 s; only files need it)

    try:
        return TypeAdapter(cls).validate_python(values)
    except ValidationError as error:
        told = [(_place(e["loc"]), e["type"], e["msg"]) for e in error.errors()]
    moved = getattr(cls, "MOVED", {})
    fixed = [place for place, kind, _ in told if kind == UNKNOWN and place not in moved and _is_fixed(cls, place)]
    problems = [_problem(cls, *one) for one in told if one[0] not in fixed]
    if fixed:
        problems.append(f"constants since 0.2, to be left out: {', '.join(dict.fromkeys(fixed))}")
    raise ConfigError(f"{where}: {'; '.join(dict.fromkeys(problems))}")


def load(cls: type[T], settings: object, overrides: dict[str, Any] | None = None, positive: Sequence[str] = ()) -> T:
    """`cls` from settings (`AnyConfig`, or None: its defaults) with `overrides` (nested; None means not given) on top.

    A table of which some keys are given has for the others what it has in `cls`, be that other than the defaults of the
    table's own type. An object of `cls`, or of one of its tables, says all of its keys. Raises ConfigError that lists
    every unknown key and bad value: numbers below 0 or of nearly nothing, and of `positive` and the `POSITIVE` of `cls`
    those not above it.
    """
    given = _merge({} if settings is None else _tables(cls, settings), overrides or {})
    if settings is None and not _says(given):
        return cls()
    where = str(settings) if isinstance(settings, str | PathLike) else "options"
    built = build(cls, _upon(cls(), given), where)
    names = (*getattr(cls, "POSITIVE", ()), *positive)
    problems = _not_positive(built, names)
    problems |= {place: told for place, told in _too_small(cls(), built) if place not in problems}
    if problems:
        raise ConfigError(f"{where}: {'; '.join(problems.values())}")
    return built


def _too_small(default: Any, given: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Where numbers that are never negative are below 0, or above it by nearly nothing, and what is wrong with it."""
    if is_dataclass(default) and type(default) is type(given):
        for f in fields(default):
            if f.name not in getattr(type(default), "SIGNED", ()):
                where = f"{place}.{f.name}".lstrip(".")
                yield from _too_small(getattr(default, f.name), getattr(given, f.name), where)
        return
    usual, found = (v if isinstance(v, tuple) else (v,) for v in (default, given))
    numbers = [v for v in (*usual, *found) if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) < len(usual) + len(found) or any(v < 0 for v in usual):
        return
    least = TINIEST * min((*usual, 1.0))
    if any(v < 0 for v in found):
        yield place, f"{place}: expected 0 or more, found {given}"
    elif any(0 < v < least for v in found):
        yield place, f"{place}: expected at least {least:g}, found {given}"


def _tables(cls: type, settings: object) -> dict[str, Any]:
    """What the settings say, as nested tables."""
    if isinstance(settings, str | PathLike):
        return _read(Path(settings))
    if isinstance(settings, Mapping):
        return dict(_plain(settings))
    inside = {f.name: type(getattr(cls(), f.name)) for f in fields(cls)}
    if type(settings) is cls:
        return dict(_plain(settings))
    for name, kind in inside.items():
        if type(settings) is kind and is_dataclass(kind):
            return {name: _plain(settings)}
    known = ", ".join([cls.__name__, *(kind.__name__ for kind in inside.values() if is_dataclass(kind))])
    raise ConfigError(f"config: expected a TOML file, its tables or an object of {known}, found {kind_of(settings)}")


def _plain(value: Any) -> Any:
    """Objects of settings within mappings and objects as nested tables."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if hasattr(type(value), "__pydantic_config__"):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    return value


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_with_line(path, str(error))) from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path}: expected tables and lists, found them nested too deeply to read") from None


def expect_positive(cfg: object, where: str, *names: str) -> None:
    """Raises ConfigError that lists all of `names` (dotted fields, numbers or lists of them) that are not above 0."""
    if problems := _not_positive(cfg, names):
        raise ConfigError(f"{where}: {'; '.join(problems.values())}")


def _not_positive(cfg: object, names: Sequence[str]) -> dict[str, str]:
    """Name -> what is wrong, of those of `names` that are not above 0."""
    problems = {}
    for name in names:
        value: Any = cfg
        for part in name.split("."):
            value = getattr(value, part)
        numbers = value if isinstance(value, tuple) else (value,)
        if not numbers or not all(v > 0 for v in numbers):
            many = "numbers" if isinstance(value, tuple) else "a number"
            problems[name] = f"{name}: expected {many} above 0, found {value}"
    return problems


def _problem(cls: type, place: str, kind: str, message: str) -> str:
    new = getattr(cls, "MOVED", {}).get(place) if kind == UNKNOWN else None
    return f"{place}: is now {new}" if new else f"{place}: {_WORDS.get(kind, message)}"


def fixed_keys(cls: type) -> set[str]:
    """The keys of a configuration class that are constants now: those of `fixed_keys.toml`."""
    fixed = _fixed_keys()
    return {key for c in cls.__mro__ for key in fixed.get(c.__name__, ())}


@cache
def _fixed_keys() -> dict[str, list[str]]:
    return tomllib.loads(Path(__file__).with_name("fixed_keys.toml").read_text(encoding="utf-8"))


def _is_fixed(cls: type, place: str) -> bool:
    """Whether the key at `place` of a configuration was once a setting and is a constant now."""
    *tables, key = place.split(".")
    inner: Any = cls()
    for name in tables:
        inner = getattr(inner, name, None)
    return key in fixed_keys(type(inner))


def _place(loc: tuple[int | str, ...]) -> str:
    """`a.b.2` of a value; which of several types was tried is left out."""
    names = [str(part) for part in loc if not (str(part) in _TYPES or "[" in str(part))]
    return ".".join(names) or "(top)"


def _with_line(path: Path, message: str) -> str:
    """`path:line: message`, from the `(at line 3, column 1)` that tomllib ends a message with."""
    what, _, where = message.rpartition(" (at line ")
    line = where.split(",")[0]
    return f"{path}:{line}: {what}" if line.isdecimal() else f"{path}: {message}"


def _upon(default: Any, given: dict[str, Any]) -> dict[str, Any]:
    """`given`, and the fields of `default` of which it says nothing."""
    out = {f.name: getattr(default, f.name) for f in fields(default)}
    for key, value in given.items():
        inner = out.get(key)
        out[key] = _upon(inner, value) if isinstance(value, dict) and is_dataclass(inner) else value
    return out


def _says(given: dict[str, Any]) -> bool:
    """Whether there is any value in nested tables."""
    return any(_says(value) if isinstance(value, dict) else True for value in given.values())


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    out = dict(below)
    for key, value in above.items():
        if isinstance(value, dict):
            inner = out.get(key, {})
            out[key] = _merge(inner, value) if isinstance(inner, dict) else inner  # no table: told where it is built
        elif value is not None:
            out[key] = value
    return out
