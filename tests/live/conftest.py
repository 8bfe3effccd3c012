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
def direct(source):
    """What `map` makes of the logs; who compares with it is marked `drawn`, as its pictures are."""
    folder = source.parent / "direct"
    map_logs(source, folder)
    return folder


@pytest.fixture
def fleet(tmp_path, source):
    made = Fleet(tmp_path, source)
    yield made
    made.end()
