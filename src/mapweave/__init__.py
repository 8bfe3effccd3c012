"""mapweave: one map, with honest uncertainty, from the logs of many robots."""

from typing import Any

__version__ = "0.1.0"

_VERBS: dict[str, str] = {}


def __getattr__(name: str) -> Any:
    """Public verbs are imported when first used, so that `import mapweave` stays instant."""
    if name in _VERBS:
        from importlib import import_module

        module, _, attribute = _VERBS[name].partition(":")
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module 'mapweave' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *_VERBS]
