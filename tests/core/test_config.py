"""A table of which some keys are given keeps what the rest of it is set to where it is used."""

from dataclasses import field, fields, is_dataclass

import pytest

from mapweave.api.configuration import JOBS, configuration_class
from mapweave.api.explore import LaserMissionConfig
from mapweave.api.locate import LocateConfig
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


@pytest.mark.parametrize(
    ("cls", "said", "told"),
    [
        (LaserMapConfig, {"graph": {"hypotheses": -1}}, r"laser\.graph\.hypotheses: expected 0 or more, found -1"),
        (LaserMapConfig, {"graph": {"joint": {"widths": [0.1, -1.0]}}}, r"joint\.widths: expected 0 or more"),
        (LandmarkMapConfig, {"lag": -0.1}, r"ekf\.lag: expected 0 or more, found -0\.1"),
        (LandmarkMapConfig, {"far": 0.0}, r"ekf\.far: expected a number above 0, found 0"),
    ],
)
def test_a_number_below_zero_or_one_that_divides_and_is_zero_is_refused_by_name(cls, said, told):
    with pytest.raises(ConfigError, match=told):
        load(cls, {"laser" if cls is LaserMapConfig else "ekf": said})


@pytest.mark.parametrize(
    ("cls", "said", "told"),
    [
        (LandmarkMapConfig, {"placing": {"bearing": 1e-12}}, r"placing\.bearing: expected at least 8e-08, found 1e-12"),
        (LandmarkMapConfig, {"smoothing": {"longest_step": 1e-12}}, r"longest_step: expected at least 1e-06"),
        (LandmarkMapConfig, {"smoothing": {"shortest_step": 1e9}}, r"smoothing\.shortest_step: expected 30 s or less"),
        (LandmarkMapConfig, {"ekf": {"speed_scale_sd": -1.0}}, r"ekf\.speed_scale_sd: expected 0 or more"),
        (LocateConfig, {"swarm": {"prior_sigma": 0.0}}, r"swarm\.prior_sigma: expected a number above 0"),
        (LocateConfig, {"motion": {"acceleration": 0.0}}, r"motion\.acceleration: expected a number above 0"),
        (LocateConfig, {"commanded": {"speed": 0.0}}, r"commanded\.speed: expected a number above 0"),
        (LocateConfig, {"motion": {"kernel": 1e-12}}, r"kernel: expected 0 or at least 0\.1"),
        (LocateConfig, {"motion": {"scale_w": -1.0}}, r"motion\.scale_w: expected 0 or more"),
        (ExploreConfig, {"submap": {"range_sd": 1e-12}}, r"submap\.range_sd: expected at least 2e-07"),
    ],
)
def test_settings_that_would_leave_nothing_to_solve_are_refused_by_name(cls, said, told):
    with pytest.raises(ConfigError, match=told):
        load(cls, said)


def test_signed_numbers_and_zeros_that_mean_none_are_taken():
    assert load(LandmarkMapConfig, {"ekf": {"bearing_bias": -0.01}}).ekf.bearing_bias == -0.01
    assert load(LaserMapConfig, {"laser": {"graph": {"hypotheses": 0}}}).laser.graph.hypotheses == 0
    weak = {"robots": {"law": {"most": 255.0}}}  # a number whose default is huge, as no limit is
    assert load(LaserMissionConfig, weak).robots.law.most == 255.0


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"resolution": 0.0}, "resolution: expected a number above 0"),
        ({"resolution": 5.0}, r"resolution: expected at most 2 \[m\]"),
        ({"front_end": {"sd_xy": 0.0}}, r"front_end\.sd_xy: expected a number above 0"),
        ({"graph": {"joint": {"widths": []}}}, r"graph\.joint\.widths: expected numbers above 0"),
        ({"merge": {"sure": 2.0}}, r"merge\.sure: expected a probability"),
    ],
)
def test_settings_of_laser_maps_that_cannot_be_are_refused_by_name(said, told):
    with pytest.raises(ConfigError, match=told):
        load(LaserMapConfig, {"laser": said}).laser.check()


def test_what_stands_in_place_of_a_table_is_told_whatever_options_are_given():
    with pytest.raises(ConfigError, match="laser"):
        load(LaserMapConfig, {"laser": 3}, {"laser": {"particles": None}})
