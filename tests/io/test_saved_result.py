"""A result file of which settings became constants since is read; of any other change its class is refused."""

import pytest

from mapweave.core.config import config
from mapweave.core.errors import ReaderError
from mapweave.exploration.laser.config import LaserExploreConfig
from mapweave.io.saved_result import read_result, write_result
from mapweave.mapping.known_places import KnownPlacesConfig


def called(cls, like, name=None):
    """`cls` as if it stood where `like` stands, under its name or another."""
    cls.__module__, cls.__qualname__ = like.__module__, name or like.__qualname__
    return cls


@config
class OldTable:
    same: float = 0.8


@config
class OldPlaces(KnownPlacesConfig):
    near: float = 2.0


@config
class OldPlan(LaserExploreConfig):
    goals: OldTable = called(OldTable, LaserExploreConfig, "GoalConfig")()


@pytest.mark.parametrize(
    ("old", "now", "given"),
    [(OldPlaces, KnownPlacesConfig, {"enough": 12}), (OldPlan, LaserExploreConfig, {"max_steps": 40})],
    ids=["key", "table"],
)
def test_a_result_whose_settings_became_constants_is_read_without_them(tmp_path, old, now, given):
    write_result(tmp_path, {"config": called(old, now)(**given)})
    assert read_result(tmp_path) == {"config": now(**given)}


def test_a_result_with_fields_that_never_were_settings_is_refused(tmp_path):
    @config
    class Other(KnownPlacesConfig):
        thrust: float = 2.0

    write_result(tmp_path, called(Other, KnownPlacesConfig)())
    with pytest.raises(ReaderError, match=r"whose KnownPlacesConfig is not this one's: make the result again$"):
        read_result(tmp_path)


def test_a_class_that_is_no_more_is_refused_where_it_is_needed(tmp_path):
    write_result(tmp_path, called(OldTable, LaserExploreConfig, "GoalConfig")())
    with pytest.raises(ReaderError, match=r"whose GoalConfig is not this one's: make the result again$"):
        read_result(tmp_path)
