"""One map, with honest uncertainty, from the logs of many robots.

    import mapweave

    result = mapweave.map(["robot1.bag", "robot2.mcap"], "out")  # joins both logs; writes the folder `out`
    print(result.summary())

Verbs, each with its options in `help(mapweave.map)` and so on:

    map, fuse               one map of the logs of a team; of several results
    read                    a log of any format: its robots, events, tables
    load                    a result read back from its folder
    evaluate                the score of a result against what is true
    compare                 what changed between two laser results of one place
    view                    a result in the browser or in the Rerun viewer
    edit                    a laser result in the browser, to decide by hand on places and robots
    localize                a robot found and followed in a finished laser map
    locate                  the positions of a swarm whose robots see each other
    explore                 robots that decide where to drive
    solve_pose_graph, solve_ranges     a pose graph from anywhere; robots and beacons placed by ranges
    live_robot, live_robots, live_map, live_view, live_keys     a team that drives now
    live_follow, live_explore     what such a team knows, told a program; where its robots are to drive
    simulate_landmarks, simulate_laser, simulate_team, simulate_swarm     logs with their truth
    reproduce_kojima, reproduce_hamatani, reproduce_hara, reproduce_yuan     the experiments of four papers
    configuration, demo     all settings; a first result
    doctor                  what bends a map, its evidence and what mends it; a check of the installation
    self_test               every kind of job tried on simulated data

`LandmarkSlam` and `LaserSlam` map one robot while it drives, `Localizer` finds it in a finished map; `LiveLaser` is one
of a live team. The other names are the results that verbs give, their options and settings, and the errors they raise.
Each is imported when it is first used.
"""

import re
from importlib import import_module
from pkgutil import get_data

from .core.version import __version__

_IMPORT = re.compile(r"^from \.([\w.]+) import (\([^)]*\)|.+)$", re.MULTILINE)
_HOMES = {  # public name: the module that defines it under the same name, as the stub that type checkers read says
    name: home
    for home, names in _IMPORT.findall((get_data(__name__, "__init__.pyi") or b"").decode())
    for name in re.findall(r"\w+ as (\w+)", names)
    if name != "__version__"
}

__all__ = ("__version__", *sorted(_HOMES))  # noqa: PLE0604

_LIVE = {"zenoh": "eclipse-zenoh", "msgspec": "msgspec", "cryptography": "cryptography"}  # the extra [live]


def _lacking(name: str, module: str) -> object:
    """Stands for a name whose extra is not installed: calling it says so."""

    def lacks(*args: object, **options: object) -> None:  # noqa: ARG001
        from .core.errors import UsageError

        raise UsageError(f"{name} needs {_LIVE[module]}: install mapweave with the extra [live]")

    return lacks


def __getattr__(name: str) -> object:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        value = getattr(import_module(f"{__name__}.{home}"), name)
    except ModuleNotFoundError as error:
        if error.name not in _LIVE:
            raise
        return _lacking(name, error.name)
    from .core.signatures import readable

    readable(value)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
