"""The report of laser maps says what was done, warns, and shows every figure; no figure is empty."""

import re

import numpy as np
import pytest
from matplotlib import image

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.report.laser import write_laser_report
from mapweave.report.laser_figures import aligned

from ..io.made_laser_map import made_laser_map


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    made = made_laser_map()
    truth = Track(made.track.t, se2.compose(np.array([4.0, 2.0, 1.0]), made.track.pose), None, "truth")
    write_laser_report(folder, [made], {"1": truth}, ["robot1: translation 0.01 m"])
    return folder, (folder / "report.html").read_text()


def test_the_page_tells_method_feature_warnings_what_was_dropped_and_the_score(page):
    _, html = page
    for word in (
        "particle, 100 particles",
        "normalised",
        "something to know",
        "2 x scan doubled",
        "translation 0.01 m",
    ):
        assert word in html
    assert len(re.findall("<img", html)) == 5
    assert "http" not in html.replace("http://www.w3.org", "")


def test_every_figure_is_there_and_shows_something(page):
    folder, _ = page
    names = ["map", "trajectory", "scans", "calibration"]
    for path in [*(folder / "figures" / f"robot1_{n}.png" for n in names), folder / "local/robot1/intensity.png"]:
        pixels = image.imread(path)[..., :3]
        assert (pixels.min(axis=2) < 0.95).mean() > 0.01, path.name


@pytest.mark.slow
def test_the_intensity_picture_uses_the_colour_scale_for_any_colour_vision(page):
    from matplotlib import colormaps

    folder, _ = page
    pixels = (255 * image.imread(folder / "local/robot1/intensity.png")[..., :3]).round().astype(int).reshape(-1, 3)
    scale = (255 * colormaps["cividis"](np.linspace(0, 1, 256))[:, :3]).round().astype(int)
    found = {tuple(p) for p in pixels.tolist()} & {tuple(c) for c in scale.tolist()}
    assert len(found) > 50


@pytest.mark.slow
def test_a_map_without_intensity_has_no_calibration_section_but_a_picture(tmp_path):
    write_laser_report(tmp_path, [made_laser_map(light=False)], {}, [])
    assert (tmp_path / "local/robot1/intensity.png").exists()
    assert not (tmp_path / "figures/robot1_calibration.png").exists()
    assert "Estimated from this log itself" not in (tmp_path / "report.html").read_text()


def test_the_truth_is_shown_where_one_rigid_motion_puts_it_nearest_to_the_estimate():
    made = made_laser_map()
    truth = Track(made.track.t + 0.0, se2.compose(np.array([4.0, 2.0, 1.0]), made.track.pose), None, "truth")
    assert np.allclose(aligned(truth, made.track).pose, made.track.pose, atol=1e-9)
