"""Names that a page, a figure or a folder could take for something else are shown as they are, and harm nothing."""

from html import escape

import numpy as np

import mapweave
from mapweave.io.table import read_table
from mapweave.report.elements import tag
from mapweave.report.html import Page
from mapweave.report.style import figure

NAMES = ("$\\frac{", "<script>alert(1)</script>", "../../up", "a,b", 'say "no"', "con", "$x$", "ö 1")


def test_figures_take_no_name_for_a_formula(tmp_path):
    with figure(tmp_path / "names.png") as (_, ax):
        for k, name in enumerate(NAMES):
            ax.plot([0, 1], [0, k], label=name)
            ax.annotate(name, (0, k))
        ax.set_title(NAMES[0])
        ax.legend()
    assert (tmp_path / "names.png").stat().st_size > 1000


def test_pages_show_markup_in_names_as_text(tmp_path):
    page = Page(NAMES[1], NAMES[1])
    page.section(NAMES[1])
    page.text(NAMES[1], warn=True)
    page.cards([(NAMES[1], NAMES[1])])
    page.table([NAMES[1]], [[name] for name in NAMES])
    with figure(tmp_path / "f.png"):
        pass
    page.figure(tmp_path / "f.png", NAMES[1])
    assert "<script" not in page.html()
    assert page.html().count("&lt;script&gt;") >= 7


def test_an_element_escapes_what_is_put_into_it_unless_that_is_one():
    name = "<b>&\"'\u202e\u05d0\U0001f600" + 300 * "x"
    inner = tag("i", name, title=name)
    assert inner == f'<i title="{escape(name)}">{escape(name)}</i>'
    assert tag("p", inner, name, class_="c") == f'<p class="c">{inner}{escape(name)}</p>'
    assert tag("br") == "<br>"


def test_a_swarm_of_robots_with_such_names_is_located_and_stays_in_its_folder(tmp_path):
    n = len(NAMES)
    place = np.random.default_rng(0).normal(0, 5, (n, 2))
    rows = ["observer,target,bearing"]
    for i in range(n):
        for j in range(n):
            if i != j:
                dx, dy = place[j] - place[i]
                a, b = (f'"{name.replace(chr(34), chr(34) * 2)}"' for name in (NAMES[i], NAMES[j]))
                rows.append(f"{a},{b},{np.arctan2(dy, dx):.9f}")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "s.csv").write_text("\n".join(rows) + "\n")
    anchors = {NAMES[k]: tuple(place[k]) for k in (0, 1)}
    out = tmp_path / "work" / "out"
    mapweave.locate(tmp_path / "in" / "s.csv", out, anchors=anchors, sigma=0.01)
    assert "<script>alert" not in (out / "report.html").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "work"]
    assert [p.name for p in (tmp_path / "work").iterdir()] == ["out"]
    table = read_table(out / "positions.csv")
    assert set(table.columns["id"]) == set(NAMES)
