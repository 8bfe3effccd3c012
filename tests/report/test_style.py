"""How figures look: names as they are, logarithmic axes in plain numbers."""

import numpy as np
import pytest

from mapweave.report.style import drawn, figure, name_points


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
