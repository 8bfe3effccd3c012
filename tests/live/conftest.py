"""A recorded team, and the processes that replay it."""

import pytest

from mapweave.api.map import map as map_logs
from mapweave.api.simulate import simulate_landmarks

from .processes import Fleet


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live") / "team"
    simulate_landmarks(folder, robots=2, minutes=1.0, seed=3)
    return folder


@pytest.fixture(scope="session")
def _maps():
    return {}


@pytest.fixture
def direct(request, source, _maps):
    """What `map` makes of the logs, once with its figures, for who is marked `drawn`, and once with a dot for each."""
    whole = request.node.get_closest_marker("drawn") is not None
    if whole not in _maps:
        _maps[whole] = source.parent / ("drawn" if whole else "direct")
        map_logs(source, _maps[whole])
    return _maps[whole]


@pytest.fixture
def fleet(tmp_path, source):
    made = Fleet(tmp_path, source)
    yield made
    made.end()
