"""Settings are the same whether a file, tables or an object say them."""

import pytest

import mapweave
from mapweave.api.configuration import JOBS, configuration_class
from mapweave.core.config import load
from mapweave.core.config_text import as_toml
from mapweave.core.errors import ConfigError


@pytest.mark.parametrize(("job", "laser"), JOBS)
def test_a_file_its_tables_and_an_object_say_the_same(tmp_path, job, laser):
    kind = configuration_class(job, laser=laser)
    (tmp_path / "all.toml").write_text(as_toml(kind(), ""), encoding="utf-8")
    assert load(kind, kind()) == load(kind, {}) == load(kind, str(tmp_path / "all.toml")) == kind()


def test_an_object_of_one_table_says_all_of_that_table_and_options_win():
    mine = mapweave.LaserConfig(particles=7, resolution=0.05)
    cfg = load(mapweave.LaserMapConfig, mine, {"laser": {"particles": 9, "method": None}})
    assert (cfg.laser.particles, cfg.laser.resolution, cfg.laser.method) == (9, 0.05, "graph")
    assert load(mapweave.LaserMapConfig, {"laser": mine}).laser == mine
    assert mapweave.LandmarkSlam(mapweave.EkfSlamConfig()).cfg == mapweave.LandmarkSlam().cfg
    assert mapweave.LaserSlam(mapweave.LaserConfig(), robot="2").cfg == mapweave.LaserSlam().cfg


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (mapweave.FuseConfig(), "an object of LaserMapConfig, LaserConfig, found FuseConfig"),
        (3, "found int"),
        ({"laser": {"cell": 0.1}}, r"laser\.cell: unknown key"),
        ({"laser": {"resolution": "small"}}, r"laser\.resolution: expected a number"),
    ],
)
def test_settings_of_another_job_are_refused_by_name(given, told):
    with pytest.raises(ConfigError, match=told):
        load(mapweave.LaserMapConfig, given)
