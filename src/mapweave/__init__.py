"""mapweave: one map, with honest uncertainty, from the logs of many robots."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .core.version import __version__ as __version__

__all__ = (
    "demo",
    "evaluate",
    "explore",
    "fuse",
    "localize",
    "locate",
    "map",
    "reproduce_hamatani",
    "reproduce_hara",
    "reproduce_kojima",
    "reproduce_yuan",
    "simulate_landmarks",
    "simulate_laser",
    "simulate_swarm",
    "view",
)

if TYPE_CHECKING:
    from .verbs.demo import demo as demo
    from .verbs.evaluate import evaluate as evaluate
    from .verbs.explore import explore as explore
    from .verbs.fuse import fuse_results as fuse
    from .verbs.localize import localize as localize
    from .verbs.locate import locate as locate
    from .verbs.map import map_logs as map  # noqa: A004
    from .verbs.reproduce_hamatani import reproduce_hamatani as reproduce_hamatani
    from .verbs.reproduce_hara import reproduce_hara as reproduce_hara
    from .verbs.reproduce_kojima import reproduce_kojima as reproduce_kojima
    from .verbs.reproduce_yuan import reproduce_yuan as reproduce_yuan
    from .verbs.simulate_landmarks import simulate_landmarks as simulate_landmarks
    from .verbs.simulate_laser import simulate_laser as simulate_laser
    from .verbs.simulate_swarm import simulate_swarm as simulate_swarm
    from .verbs.view import view as view

_VERBS: dict[str, str] = {
    # public name: where it lives; keep in step with the block above, which type checkers read
    "demo": "mapweave.verbs.demo:demo",
    "evaluate": "mapweave.verbs.evaluate:evaluate",
    "explore": "mapweave.verbs.explore:explore",
    "fuse": "mapweave.verbs.fuse:fuse_results",
    "localize": "mapweave.verbs.localize:localize",
    "locate": "mapweave.verbs.locate:locate",
    "map": "mapweave.verbs.map:map_logs",
    "reproduce_hamatani": "mapweave.verbs.reproduce_hamatani:reproduce_hamatani",
    "reproduce_hara": "mapweave.verbs.reproduce_hara:reproduce_hara",
    "reproduce_kojima": "mapweave.verbs.reproduce_kojima:reproduce_kojima",
    "reproduce_yuan": "mapweave.verbs.reproduce_yuan:reproduce_yuan",
    "simulate_landmarks": "mapweave.verbs.simulate_landmarks:simulate_landmarks",
    "simulate_laser": "mapweave.verbs.simulate_laser:simulate_laser",
    "simulate_swarm": "mapweave.verbs.simulate_swarm:simulate_swarm",
    "view": "mapweave.verbs.view:view",
}


class _Verb:
    """A public verb, imported when first used, so that `import mapweave` stays instant.

    Some rooms carry a verb's name (`mapweave.fuse`); Python binds a room to this module when it is imported, and the
    setter lets that pass: the attribute stays the verb, `from mapweave.fuse import ..` still finds the room.
    """

    def __init__(self, where: str) -> None:
        self.module, _, self.attribute = where.partition(":")

    def __get__(self, module: object, owner: type | None = None) -> Any:
        return getattr(import_module(self.module), self.attribute)

    def __set__(self, module: object, room: object) -> None:
        pass


class _Package(ModuleType):
    """The package, with the verbs as attributes nothing else can take."""

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *_VERBS]


for _name, _where in _VERBS.items():
    setattr(_Package, _name, _Verb(_where))
sys.modules[__name__].__class__ = _Package
