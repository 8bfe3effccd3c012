"""`mapweave config`: every key with its default and meaning, as a file that can be edited and handed back."""

import re
import tomllib
from dataclasses import replace

import pytest

from mapweave.api.configuration import JOBS, configuration, configuration_class
from mapweave.cli import _run
from mapweave.core.config import build, config, load
from mapweave.core.config_text import as_toml, keys, meanings
from mapweave.core.errors import ConfigError, UsageError


@pytest.mark.parametrize(("job", "laser"), JOBS)
def test_the_defaults_printed_and_read_again_are_the_defaults(job, laser, tmp_path):
    cls = configuration_class(job, laser=laser)
    path = tmp_path / "settings.toml"
    path.write_text(configuration(job, laser=laser), encoding="utf-8")
    assert load(cls, path) == cls()


@pytest.mark.parametrize(("job", "laser"), JOBS)
def test_every_key_is_printed_and_says_what_it_means(job, laser):
    cfg = configuration_class(job, laser=laser)()
    text = configuration(job, laser=laser)
    silent = [key.dotted for key in keys(cfg) if not re.search(r"[A-Za-z]{3,}", re.sub(r"\[[^]]*\]", "", key.meaning))]
    assert not silent
    printed = [line for line in text.splitlines() if re.match(r"(# )?\w+ = ", line)]
    assert len(printed) == len(list(keys(cfg)))


def test_an_edited_key_is_read_and_a_key_that_is_not_set_stays_so(tmp_path):
    text = configuration("map").replace("range_floor = 0.05", "range_floor = 0.5")
    values = tomllib.loads(text)
    assert values["ekf"]["range_floor"] == 0.5
    cls = configuration_class("map")
    assert build(cls, values) == replace(cls(), ekf=replace(cls().ekf, range_floor=0.5))
    assert "# nothing = (not set)" in as_toml(Words())


def test_laser_and_landmark_keys_stand_in_tables():
    landmarks = {"agreement", "ekf", "fuse", "placing", "smoothing", "online"}
    for laser, tables in ((False, landmarks), (True, {"laser"})):
        assert set(tomllib.loads(configuration("map", laser=laser))) == tables
    assert set(tomllib.loads(configuration("locate"))) == {"swarm", "motion", "commanded"}


@config
class Words:
    """Every form a value may take."""

    quoted: str = 'a "word" \\ here'  # text with marks
    flag: bool = True
    """Told below the line,
    over two lines."""
    pair: tuple[float, int] = (
        1e-7,  # small
        2,  # and whole
    )
    nothing: int | None = None


def test_meanings_come_from_comments_and_from_text_below_and_values_survive():
    told = meanings(Words)
    assert told == {
        "quoted": "text with marks",
        "flag": "Told below the line, over two lines.",
        "pair": "small and whole",
        "nothing": "",
    }
    assert build(Words, tomllib.loads(as_toml(Words()))) == Words()
    with pytest.raises(ConfigError, match="no form in TOML"):
        as_toml(replace(Words(), quoted={1}))


def test_the_command_prints_it_and_refuses_jobs_without_settings(capsys):
    assert _run(["config", "map", "--laser"]) == 0
    out = capsys.readouterr().out
    assert out == configuration("map", laser=True)
    assert "[laser.filter]" in out
    assert _run(["config", "simulate"]) == 2
    assert _run(["config", "locate", "--laser"]) == 2
    assert capsys.readouterr().err.count("\n") == 2
    with pytest.raises(UsageError, match="expected one of map, map --laser"):
        configuration("view")
