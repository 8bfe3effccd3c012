"""Configuration: typed frozen dataclasses, filled from TOML, every mistake told at once.

A config stands beside the code that reads it: ``@config class IcpConfig: max_correspondence: float = 0.5  # [m]``.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, dataclass_transform

from .errors import ConfigError

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def config(cls: type[T]) -> type[T]:
    """A frozen, keyword-only dataclass that refuses unknown keys when it is read from a file."""
    made = dataclass(frozen=True, slots=True, kw_only=True)(cls)
    made.__pydantic_config__ = {"extra": "forbid"}  # type: ignore[attr-defined]
    return made


def build(cls: type[T], values: dict[str, Any], where: str = "configuration") -> T:
    """`cls` from nested `values`; raises ConfigError that lists every unknown key and bad value."""
    from pydantic import TypeAdapter, ValidationError  # noqa: PLC0415  (costs 0.1 s; only files need it)

    try:
        return TypeAdapter(cls).validate_python(values)
    except ValidationError as error:
        told = "; ".join(f"{'.'.join(map(str, e['loc'])) or '(top)'}: {e['msg']}" for e in error.errors())
        raise ConfigError(f"{where}: {told}") from None


def load(cls: type[T], path: Path | None, overrides: dict[str, Any] | None = None) -> T:
    """`cls` from a TOML file (or its defaults) with `overrides` (nested; None means not given) on top."""
    values: dict[str, Any] = {}
    if path is not None:
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: {error}") from None
    return build(cls, _merge(values, overrides or {}), str(path) if path else "options")


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    out = dict(below)
    for key, value in above.items():
        if isinstance(value, dict):
            inner = out.get(key)
            out[key] = _merge(inner if isinstance(inner, dict) else {}, value)
        elif value is not None:
            out[key] = value
    return out
