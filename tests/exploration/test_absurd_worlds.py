"""Worlds and settings that nobody could explore are refused at once, with the number that is too large."""

import numpy as np
import pytest
from PIL import Image

from mapweave.api.explore import explore
from mapweave.core.errors import ConfigError, DataError, MapweaveError, ReaderError, UsageError

FIELD = "lower = [-5, -5]\nupper = [5, 5]\nlandmarks = [[-3.0, 3.0], [3.0, 3.0]]\n"
WALLED = FIELD + "walls = [[0, 0, 1, 0]]\nstarts = [[2, 2, 0]]\n"
HALL = (
    'sensor = "laser"\nwalls = [[0, 0, W, 0], [W, 0, W, 5], [W, 5, 0, 5], [0, 5, 0, 0]]\nstarts = [[1.5, 2.5, 0.0]]\n'
)
ROOM = HALL.replace("W", "6")
PLAN = 'walls = "plan.png"\nstarts = [[2, 3, 0]]\n'
LASER_PLAN = 'sensor = "laser"\n' + PLAN


def refused(folder, world, options, error, message):
    """`explore` raises `error` with `message`, and writes nothing."""
    path = folder / "world.toml"
    path.write_text(world, encoding="utf-8")
    if "config" in options:
        (folder / "settings.toml").write_text(options["config"], encoding="utf-8")
        options = options | {"config": folder / "settings.toml"}
    with pytest.raises(error, match=message) as told:
        explore(str(path), folder / "out", **options)
    assert isinstance(told.value, MapweaveError)
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("world", "error", "message"),
    [
        (FIELD + f"starts = {[[0.0, 0, 0]] * 3000}\n", UsageError, r"starts: expected at most 200 robots, found 3,000"),
        (
            FIELD + "walls = [[0, 0, 1e308, 0]]\n",
            ConfigError,
            r"walls\.0: expected numbers up to 100000, found 1e\+308",
        ),
        (FIELD + "starts = [[0, 0, 1e308]]\n", ConfigError, r"starts\.0: .* found 1e\+308"),
        (FIELD.replace("-3.0", "1e308"), ConfigError, r"landmarks\.0: .* found 1e\+308"),
        (FIELD.replace("[[-3.0, 3.0], [3.0, 3.0]]", "1000000000"), ConfigError, "at most 3,000, found 1,000,000,000"),
        ("lower = [-9e4, -9e4]\nupper = [9e4, 9e4]\n", ConfigError, r"cells of 1 m has 3\.24e\+10 of them, expected"),
        ("lower = [0, 0]\nupper = [1e-300, 1e-300]\nlandmarks = 2\n", ConfigError, "smaller than a cell of 1 m"),
        (HALL.replace("W", "1e6"), ConfigError, r"walls\.0: expected numbers up to 100000, found 1e\+06"),
        (HALL.replace("W", "99999"), ConfigError, "99999 m x 5 m in cells of 0.1 m has 5e"),
        (HALL.replace("W", "1e308"), ConfigError, r"found 1e\+308"),
        (ROOM.partition("starts")[0] + "starts = []\n", ConfigError, "expected starts = "),
        ("office = 200\nstarts = []\n", ConfigError, "starts: expected .* found none"),
        ("office = 1e9\n", ConfigError, r"office: expected 150 to 20000 m\^2, found 1e\+09"),
        ('sensor = "laser"\nwalls = []\nstarts = [[0, 0, 0]]\n', ConfigError, "walls: expected segments"),
    ],
)
def test_a_world_that_is_too_large_or_empty_is_refused_with_the_number(tmp_path, world, error, message):
    refused(tmp_path, world, {}, error, message)


@pytest.mark.parametrize("world", [FIELD, ROOM])
@pytest.mark.parametrize(
    ("options", "message"),
    [({"robots": 3000}, "at most 200 robots, found 3,000"), ({"noise": 1e300}, "a positive factor up to 10000")],
)
def test_options_beyond_all_use_are_refused_with_the_number(tmp_path, world, options, message):
    refused(tmp_path, world, options, UsageError, message)


@pytest.mark.parametrize(
    ("world", "settings", "message"),
    [
        (FIELD, "[mission]\ncell = 1e-5", r"mission\.cell, 2 robots: .* has 1e\+12 of them"),
        (FIELD, "[mission]\ncell = 1e-9", r"mission\.cell: expected at least 1e-06, found 1e-09"),
        (WALLED, "[walls]\npath_cell = 1e-5", r"walls\.path_cell / 4: .* of them"),
        (FIELD, "[commands]\nspeeds = [1e308]", r"commands\.speeds\.0: expected at most 1e\+09, found 1e\+308"),
        (ROOM, "[plan]\nresolution = 1e9", r"plan\.resolution: expected at most 1, found 1e\+09"),
        (ROOM, "[plan]\nresolution = 1e-6", r"plan\.resolution: .* has 3e\+13 of them"),
        (ROOM, "map_resolution = 1e-7", "map_resolution: .* of them"),
        (ROOM, "[plan.allocation]\nparked_cost = 300", r"constants since 0\.2, to be left out: plan\.allocation$"),
        (ROOM, "[plan]\nspeed = 0.3", r"plan\.speed: is now robots\.speed$"),
        (ROOM, "[plan]\nmax_steps = 0", r"plan\.max_steps: expected a number above 0, found 0"),
        (FIELD, "[joint.search]\ntries = 0", r"joint\.search\.tries: expected a number above 0, found 0"),
        (FIELD, "[coverage]\nradios = 3", r"coverage\.radios: unknown key"),
        (ROOM, "[robots.scanner]\nbeams = 1000000000", r"robots\.scanner\.beams: expected at most 20000"),
        (ROOM, "[robots.scanner]\nopening = 360.0", r"robots\.scanner\.opening: expected at most 6\.28319, found 360"),
        (ROOM, "[robots.scanner]\nnear = 20.0", r"robots\.scanner\.near: expected at most 12, found 20"),
        (ROOM, "[robots.law]\nfalloff = 0", r"robots\.law\.falloff: expected a number above 0, found 0"),
        (ROOM, "[robots.law]\nspecular = 5\nbeams = 1000", r"law\.specular: .* 1, found 5; .*law\.beams: .* 10, "),
    ],
)
def test_settings_that_ask_for_too_much_are_refused_with_the_number(tmp_path, world, settings, message):
    refused(tmp_path, world, {"config": settings + "\n"}, ConfigError, message)


@pytest.mark.parametrize("world", [PLAN, LASER_PLAN])
@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("resolution = 1e9\n", r"1e\+09 m a pixel: corner\.1: expected numbers up to 100000, found 4e\+10"),
        ("resolution = 1\norigin = [1e308, 0]\n", r"origin\.0: .* found 1e\+308"),
    ],
)
def test_a_plan_that_reaches_too_far_is_refused_with_the_number(tmp_path, world, more, message):
    Image.fromarray(np.full((30, 40), 255, np.uint8)).save(tmp_path / "plan.png")
    refused(tmp_path, world + more, {}, ConfigError, message)


@pytest.mark.parametrize("world", [PLAN + "resolution = 0.05\n", LASER_PLAN.replace("plan.png", "map.yaml")])
def test_a_plan_of_too_many_pixels_is_refused_before_it_is_decoded(tmp_path, world):
    """The header alone is there: whoever decodes the pixels finds none."""
    header = b"P5\n9000 9000\n255\n"
    (tmp_path / "plan.png").write_bytes(header)
    (tmp_path / "map.yaml").write_text("image: plan.png\nresolution: 0.05\norigin: [0, 0, 0]\n", encoding="utf-8")
    refused(tmp_path, world, {}, ReaderError, "expected at most 25,000,000 pixels, found 9000 x 9000")


def test_a_plan_of_a_nanometre_a_pixel_leaves_no_room(tmp_path):
    Image.fromarray(np.full((30, 40), 255, np.uint8)).save(tmp_path / "plan.png")
    refused(tmp_path, LASER_PLAN + "resolution = 1e-9\n", {}, DataError, "robot1 would start outside the walls")
