"""How figures look: names as they are, logarithmic axes in plain numbers."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from mapweave.report.scene import Scene
from mapweave.report.style import FACTORS, PALETTE, brief, drawn, figure, name_points

# Linear RGB as seen with full protanopia, deuteranopia and tritanopia (Machado, Oliveira, Fernandes 2009)
VISIONS = {
    "all cones": np.eye(3),
    "no long": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no middle": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no short": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(colour):
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    t = XYZ @ np.clip(rgb, 0, 1) / (XYZ @ np.ones(3))
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
def test_colours_of_robots_differ_for_any_colour_vision(vision):
    seen = [lab(np.array(VISIONS[vision]) @ linear(colour)) for colour in PALETTE]
    apart = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]]
    assert min(apart) > 15, "2 is the least that can be told at all"


@pytest.mark.parametrize("page", ["#ffffff", "#14171a"])
def test_colours_of_robots_are_seen_on_light_and_on_dark_pages(page):
    for colour in PALETTE:
        low, high = sorted(float(XYZ[1] @ linear(c)) for c in (colour, page))
        assert (high + 0.05) / (low + 0.05) > 2, colour


def labels(ax, axis):
    ax.figure.draw_without_rendering()
    both = (*axis.get_majorticklabels(), *axis.get_minorticklabels())
    return {text.get_text() for text in both if text.get_text()}


@pytest.mark.parametrize(
    ("top", "some"), [(0.3, {"0.01", "0.02", "0.05", "0.1", "0.2"}), (3000.0, {"0.01", "1", "100"})]
)
def test_logarithmic_axes_are_told_in_plain_numbers(top, some):
    def draw(sheet):
        with figure(sheet) as (_, ax):
            ax.plot([0, 1], [0.009, top])
            ax.set_yscale("log")

    ax = drawn(draw).axes[0]
    told = labels(ax, ax.yaxis)
    assert some <= told
    assert not any("$" in text for text in told)


def test_a_dollar_in_a_name_is_a_dollar():
    def draw(sheet):
        with figure(sheet) as (_, ax):
            ax.set_title("robot $x")

    ax = drawn(draw).axes[0]
    ax.figure.draw_without_rendering()
    assert ax.get_title(loc="left") == "robot $x"
    assert not ax.title.get_parse_math()


def test_a_letter_that_the_font_lacks_is_no_warning(tmp_path, recwarn):
    with figure(tmp_path / "a.png") as (_, ax):
        ax.plot([0, 1], [0, 1], label="\u65e5\u672c")
        name_points(ax, ["\u65e5", "\u672c"], np.eye(2))
        ax.legend()
    assert [str(told.message) for told in recwarn] == []
    assert (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("apart", "some"), [(3.0, 21), (0.4, 7), (0.0, 4)])
def test_names_of_points_cover_no_other_and_are_left_out_where_they_would(tmp_path, apart, some):
    rng = np.random.default_rng(0)
    places = np.vstack([apart * rng.normal(size=(20, 2)), [[-9, -9], [9, 9]]])
    with figure(tmp_path / "a.png") as (_, ax):
        ax.plot(*places.T, ".")
        name_points(ax, [f"landmark {k}" for k in range(22)], places)
    boxes = [text.get_window_extent() for text in ax.texts if text.get_visible()]
    assert all(box.count_overlaps(boxes) == 1 for box in boxes)
    assert some <= len(boxes) <= 22


@pytest.mark.parametrize("n", [4, 30, 200])
def test_ellipses_of_landmarks_do_not_cover_their_neighbours(n):
    side = 10.0 * np.sqrt(n)
    places = np.random.default_rng(0).uniform(0, side, (n, 2))
    covs = np.tile(1e-4 * np.eye(2), (n, 1, 1))
    scene = Scene("a hall")
    scene.points("landmarks", [str(k) for k in range(n)], places, PALETTE[0], cov=covs)
    (ax,) = drawn(scene.draw).axes
    (ellipses,) = (one for one in ax.collections if isinstance(one, EllipseCollection))
    drawn_half = 0.5 * float(ellipses.get_widths()[0])
    half = 0.01 * np.sqrt(5.991)
    assert round(drawn_half / half) in FACTORS
    assert ax.get_legend_handles_labels()[1][-1] == f"95 % ellipses {drawn_half / half:.0f} times larger"
    assert drawn_half < 0.5 * 0.5 * side / np.sqrt(n), "landmarks spread evenly are twice that apart"
    assert drawn_half > 0.004 * side, "and can be seen"


def test_a_long_name_leaves_room_in_a_picture():
    assert brief("robot 12") == "robot 12"
    assert brief("x" * 60) == "x" * 15 + "…"
