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
    from .api.demo import demo as demo
    from .api.evaluate import evaluate as evaluate
    from .api.explore import explore as explore
    from .api.fuse import fuse_results as fuse
    from .api.localize import localize as localize
    from .api.locate import locate as locate
    from .api.map import map_logs as map  # noqa: A004
    from .api.simulate_landmarks import simulate_landmarks as simulate_landmarks
    from .api.simulate_laser import simulate_laser as simulate_laser
    from .api.simulate_swarm import simulate_swarm as simulate_swarm
    from .api.view import view as view
    from .papers.hamatani.reproduce import reproduce_hamatani as reproduce_hamatani
    from .papers.hara.reproduce import reproduce_hara as reproduce_hara
    from .papers.kojima.reproduce import reproduce_kojima as reproduce_kojima
    from .papers.yuan.reproduce import reproduce_yuan as reproduce_yuan

_VERBS: dict[str, str] = {
    # public name: where it lives; keep in step with the block above, which type checkers read
    "demo": "mapweave.api.demo:demo",
    "evaluate": "mapweave.api.evaluate:evaluate",
    "explore": "mapweave.api.explore:explore",
    "fuse": "mapweave.api.fuse:fuse_results",
    "localize": "mapweave.api.localize:localize",
    "locate": "mapweave.api.locate:locate",
    "map": "mapweave.api.map:map_logs",
    "reproduce_hamatani": "mapweave.papers.hamatani.reproduce:reproduce_hamatani",
    "reproduce_hara": "mapweave.papers.hara.reproduce:reproduce_hara",
    "reproduce_kojima": "mapweave.papers.kojima.reproduce:reproduce_kojima",
    "reproduce_yuan": "mapweave.papers.yuan.reproduce:reproduce_yuan",
    "simulate_landmarks": "mapweave.api.simulate_landmarks:simulate_landmarks",
    "simulate_laser": "mapweave.api.simulate_laser:simulate_laser",
    "simulate_swarm": "mapweave.api.simulate_swarm:simulate_swarm",
    "view": "mapweave.api.view:view",
}


class _Verb:
    """A public verb, imported when first used, so that `import mapweave` stays instant.

    Some rooms carry a verb's name (`mapweave.fusion`); Python binds a room to this module when it is imported, and the
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
