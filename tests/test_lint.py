"""`benchmarks/lint.py` finds what it looks for; its neighbours draw light pictures and let long names be broken."""

import importlib.util
import re
from pathlib import Path

import gallery
import lint
import pytest
from PIL import Image

TOP = Path(__file__).parent.parent


def test_a_name_that_is_taken_is_found():
    sources = {"a": "class Gate: ...\n", "b": "class _Gate: ...\nclass Gate(int): ...\n", "c": "class _Gate: ...\n"}
    assert list(lint.classes_of_one_name(sources)) == ["Gate: the name of a class in each of a, b"]


def test_a_bare_number_is_found():
    assert lint.unexplained("GATE = 3.0\n") == ["GATE"]
    assert lint.unexplained("NEAR, FAR = 0.5, -2 * 3\n") == ["(NEAR, FAR)"]
    assert lint.unexplained("GATE: float = 3.0\n") == ["GATE"]
    assert not lint.unexplained("GATE = 3.0  # standard deviations\n# of its length [m]\nSIDE = 4\nNAME = 'x'\n")
    assert not lint.unexplained("VERSION = 3\n", whole=False)
    assert not lint.unexplained("FLAG = True\nCFG = Config(gate=3.0)\n")
    assert lint.float_defaults("def f(a, b=0.3, *, c=1.0, d=0.0, e=2.5): ...") == ["f(b)", "f(e)"]


def test_an_equation_that_no_test_names_is_found():
    tests = ['@pytest.mark.eq("Kojima12:3", "Kojima12:5")\n']
    found = list(lint.equations({"a.py": "# [Kojima12] eqs. 3-5\n"}, tests))
    assert found == ["a.py: equation Kojima12:4 is named by no test"]


def test_what_a_page_names_and_is_not_there_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(lint, "TOP", tmp_path)
    page = tmp_path / "docs" / "methods" / "a.md"
    page.parent.mkdir(parents=True)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("def test_b(): ...\n")
    page.write_text(
        "`core/gone.py` `core/se2.py` `tests/test_a.py::test_b` `tests/test_a.py::test_c` `fusion.not_there(x)`"
    )
    assert list(lint.named_on(page)) == [
        "docs/methods/a.md: no such file: core/gone.py",
        "docs/methods/a.md: no such test: tests/test_a.py::test_c",
        "docs/methods/a.md: not_there: in no source",
    ]


def test_a_picture_is_made_narrow_and_keeps_its_shape(tmp_path):
    Image.linear_gradient("L").resize((1800, 600)).convert("RGB").save(tmp_path / "wide.png")
    gallery.lighten(tmp_path / "wide.png", tmp_path / "light.png")
    with Image.open(tmp_path / "light.png") as image:
        assert image.size == (900, 300)
        assert image.mode == "P"


def test_a_long_name_may_go_on_in_the_next_line_and_is_otherwise_as_it_was():
    pytest.importorskip("sphinx")
    pytest.importorskip("latex2mathml")
    spec = importlib.util.spec_from_file_location("docs_conf", TOP / "docs" / "conf.py")
    conf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(conf)
    page = '<code class="docutils literal"><span class="pre">{}</span></code>'
    context = {"body": page.format("solve/multifrontal_of.py")}
    conf.breakable(None, "", "", context, None)
    assert context["body"] == page.format("solve/<wbr>multifrontal_<wbr>of.py")


def test_the_first_picture_of_readme_and_docs_is_a_film_that_is_light_and_ends():
    film = TOP / "docs" / "images" / "together.gif"
    for page in ("README.md", "docs/index.md"):
        (first, *_) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", (TOP / page).read_text(encoding="utf-8"))
        assert (TOP / page).parent / first == film
    assert film.stat().st_size < 1.5e6
    with Image.open(film) as image:
        assert image.n_frames > 10
        assert image.info["loop"] > 0, "what moves without an end is not to be read beside"
