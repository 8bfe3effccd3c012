"""What all tests share: runtime shape checks, the real logs, which tests are run."""

import gc
import os
import signal
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest

from . import typecheck
from .dots import save_a_dot

# Shapes and types of every function of these rooms are checked while the tests run; in production they cost nothing.
# Kernels are checked by their compiler; api and cli take what people hand them and check it themselves.
UNCHECKED = {"api", "cli", "kernels"}


def checked_rooms() -> list[str]:
    """Every room but those named above: a new room is checked from its first day."""
    house = find_spec("mapweave")
    assert house
    assert house.submodule_search_locations
    rooms = Path(house.submodule_search_locations[0]).glob("*/__init__.py")
    return sorted(room.parent.name for room in rooms if room.parent.name not in UNCHECKED)


# A shell has those it begins in the background ignore Ctrl-C; tests that press it expect that it is heard.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

if os.environ.get("MAPWEAVE_TYPECHECK", "1") == "1":
    typecheck.install([f"mapweave.{room}" for room in checked_rooms()])


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="also the tests marked slow, which take minutes")
    parser.addoption("--long", action="store_true", help="also the tests marked long, which take minutes each")


# Where nothing is compiled yet, workers that begin in one room would all compile the same kernels. Each of two is given
# one half of the tests: the first begins among landmarks, the second among lasers, and other rooms find them compiled.
# Live teams mostly wait: they come while others still compute, and none of their long tests is the last.
ORDER = ["landmarks", "fusion", "team", "swarm", "solve", "core", "evaluation", "sim", "io", "cli", "contract"]
ORDER += ["laser", "live", "kernels", "exploration"]


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What collecting makes, half a million objects, stays to the end: looking for garbage in it took a third of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def place(item) -> int:
    room = item.path.parent.name
    return ORDER.index(room) if room in ORDER else len(ORDER)


def pytest_collection_modifyitems(config, items):
    """Slow and long tests are left out unless asked for: by --all and --long, by -m, or by their own name."""
    if config.args == config.getini("testpaths"):
        items.sort(key=place)
    if config.option.markexpr or any("::" in word for word in config.args):
        return
    asked = {"slow": config.option.all or config.option.long, "long": config.option.long}
    out = [item for item in items if any(item.get_closest_marker(mark) and not on for mark, on in asked.items())]
    if out:
        config.hook.pytest_deselected(items=out)
        items[:] = [item for item in items if item not in set(out)]


# Rooms whose tests look at pictures. Elsewhere figures are made and one dot is saved for each, as rendering them takes
# half of the time of a small map. A module of another room whose tests look at its pictures is marked `drawn`.
DRAWN = {"report", "papers", "exploration", "sim"}
SAVE = pytest.StashKey()  # what saves a whole figure


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    style = sys.modules.get("mapweave.report.style")
    if style is not None:
        save = item.session.stash.setdefault(SAVE, style.save)
        whole = item.path.parent.name in DRAWN or item.get_closest_marker("drawn")
        style.save = save if whole else save_a_dot


def pytest_fixture_setup():
    typecheck.begin()


def pytest_runtest_call():
    typecheck.begin()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder with the real logs; tests that need it skip, and say so, when it is not there."""
    where = os.environ.get("MAPWEAVE_DATA")
    if not where or not Path(where).is_dir():
        pytest.skip("real logs are not here: set MAPWEAVE_DATA to the folder that holds them")
    return Path(where)


@pytest.fixture(scope="session", autouse=True)
def _parts_of_their_own(tmp_path_factory):
    """What stopped work leaves is kept apart from the user's; what is compiled is shared all the same."""
    from .caches import own_cache

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAPWEAVE_CACHE_DIR", str(own_cache(tmp_path_factory.mktemp("own"))))
        yield
