"""A table of which some keys are given keeps what the rest of it is set to where it is used."""

from dataclasses import field, fields, is_dataclass

import pytest

from mapweave.api.configuration import JOBS, configuration_class
from mapweave.api.map_landmarks import LandmarkMapConfig
from mapweave.api.map_laser import LaserMapConfig
from mapweave.core.config import config, load
from mapweave.core.errors import ConfigError, UsageError, expect_at_most
from mapweave.exploration.landmarks.config import ExploreConfig
from mapweave.exploration.laser.config import LaserTeamConfig


@config
class Inner:
    near: float = 1.0
    far: float = 2.0


@config
class Outer:
    inner: Inner = field(default_factory=lambda: Inner(far=9.0))
    name: str | None = "n"


def test_what_a_file_says_of_a_table_leaves_the_rest_of_it_as_it_was(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("[inner]\nnear = 3.0\n")
    assert load(Outer, path) == Outer(inner=Inner(near=3.0, far=9.0))
    assert load(Outer, path, {"inner": {"near": None, "far": 4.0}}) == Outer(inner=Inner(near=3.0, far=4.0))
    path.write_text("[inner]\nnearer = 3.0\n")
    with pytest.raises(ConfigError, match=r"inner\.nearer: unknown key"):
        load(Outer, path)


def tables(cfg):
    """Every table of a configuration named, no key of any given."""
    parts = {f.name: getattr(cfg, f.name) for f in fields(cfg)}
    return {name: tables(part) for name, part in parts.items() if is_dataclass(part)}


@pytest.mark.parametrize("cls", [LaserMapConfig, LandmarkMapConfig, ExploreConfig, LaserTeamConfig])
def test_naming_every_table_changes_nothing(cls):
    assert load(cls, None, tables(cls())) == cls()


@pytest.mark.parametrize(("job", "laser"), JOBS)
def test_the_defaults_are_what_a_file_that_says_nothing_gives(tmp_path, job, laser):
    nothing = tmp_path / "nothing.toml"
    nothing.write_text("", encoding="utf-8")
    kind = configuration_class(job, laser=laser)
    assert repr(load(kind, None)) == repr(load(kind, nothing))  # numbers of the same types too


def test_as_much_as_is_allowed_may_be_asked_and_neither_more_nor_nan():
    expect_at_most({"--beams": (5, 5), "--rooms": (-1, 0)})
    for value, found in ((5.5, "5.5"), (float("nan"), "nan")):
        with pytest.raises(UsageError, match=f"--rooms: expected at most 5, found {found}"):
            expect_at_most({"--beams": (5, 5), "--rooms": (value, 5)})


def test_keys_that_became_constants_are_named_in_one_message(tmp_path):
    path = tmp_path / "old.toml"
    path.write_text("[laser.filter]\nrefine_kappa = 0.2\nwrong = 1\n[laser.jump]\ndrop = 0.3\n")
    with pytest.raises(ConfigError) as told:
        load(LaserMapConfig, path)
    assert "laser.filter.wrong: unknown key" in str(told.value)
    assert "constants since 0.2, to be left out: laser.filter.refine_kappa, laser.jump" in str(told.value)
    assert str(told.value).count("since 0.2") == 1
