"""Measured tables of the documentation are those that were measured, and whoever changes one by hand is told."""

import docs_figures
import docs_prose
import pytest
from docs_tables import Table


def test_numbers_of_sentences_are_found_outside_code_maths_tables_and_ties(tmp_path):
    page = tmp_path / "docs" / "a.md"
    page.parent.mkdir()
    page.write_text(
        "# 1.5 of a head\n\nAfter 20\nseconds it errs by 3 cm, `0.25 m` or $0.5$ m of 7 robots [eq. 3](a.md#1.2).\n"
        "Held: <!-- figure: speed[2, 2] -->0.7 m.\n\n| 1.25 m |\n|---|\n\n```\n4.5 m\n```\n"
        "<!-- speed: begin -->\n9.5 m\n<!-- speed: end -->\nLess than .35 of them.\n"
    )
    found = [(free.line, free.words) for free in docs_prose.free_numbers(tmp_path)]
    assert found == [(3, "After [20] seconds"), (4, "by [3] cm,"), (16, "than [.35] of")]
    given = tmp_path / "given.txt"
    given.write_text("# told\n\n## docs/a.md\nAfter [20] seconds\nby [3] cm,\n")
    told = docs_prose.unlisted(tmp_path, given)
    assert told == ["docs/a.md:16: 'than [.35] of' is tied to no table and does not stand in given.txt"]
    given.write_text(given.read_text().replace("docs/a.md", "docs/b.md"))
    assert len(docs_prose.unlisted(tmp_path, given)) == 3
    docs_prose.write_list(tmp_path, given)
    assert docs_prose.unlisted(tmp_path, given) == []
    page.write_text("Less than .35 of them.")
    docs_prose.write_list(tmp_path, given)
    assert given.read_text() == "# told\n\n## docs/a.md\nthan [.35] of\n"


@pytest.mark.parametrize(
    ("sentence", "numbers"),
    [
        ("It takes 40 ms.", ["40"]),
        ("It errs by 1.5.", ["1.5"]),
        ("All finish in 252 to 295 steps.", ["295"]),
        ("There 81 of 94 were found, and 9 of\nthe 10 others.", ["81", "9"]),
        ("It needs 3 GiB for 7 robots of set 4, and has a table of 5.", ["3"]),
        ("As <!-- figure: speed[1, 2] -->40 ms, over $2.5$ m, `0.5`, ROS 2 and [eq. 3](a.md).", []),
    ],
)
def test_a_number_with_a_unit_a_point_or_a_count_is_found_in_a_sentence(sentence, numbers, tmp_path):
    (tmp_path / "README.md").write_text(sentence)
    found = [free.words.partition("[")[2].partition("]")[0] for free in docs_prose.free_numbers(tmp_path)]
    assert found == numbers
    given = tmp_path / "given.txt"
    given.write_text("# told\n")
    assert len(docs_prose.unlisted(tmp_path, given)) == len(numbers)


@pytest.mark.parametrize("heading", ["## docs/a.md: measured\nby [3] cm,", "by [3] cm,"])
def test_the_list_of_given_numbers_has_no_room_for_measured_ones(heading, tmp_path):
    given = tmp_path / "given.txt"
    given.write_text(f"# told\n\n{heading}\n")
    with pytest.raises(ValueError, match=r"given\.txt: .*(no page)"):
        docs_prose.unlisted(tmp_path, given)


@pytest.fixture
def docs(tmp_path):
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "a.md"
    page.write_text("Before.\n\n<!-- speed: begin -->\n| a |\n|---|\n| 1 |\n<!-- speed: end -->\n\nAfter.\n")
    return page


SPEED = Table("speed", "docs/a.md", ("python", "benchmarks/speed.py"))


def told(top, *tables):
    return docs_figures.stale(top, tables or (SPEED,))


def test_a_table_is_written_with_its_date_and_then_known(docs, tmp_path):
    assert "is not that of docs/figures/speed.json" in told(tmp_path)[0]
    text = "| a |\n|---|\n| 2.5 |"
    docs_figures.write(docs_figures.Record("speed", "docs/a.md", SPEED.told, "2026-11-22", "abc1234", text), tmp_path)
    assert told(tmp_path) == []
    page = docs.read_text()
    assert page.startswith(
        "Before.\n\n<!-- speed: begin -->\n| a |\n|---|\n| 2.5 |\n\nMeasured 2026-11-22 at abc1234 by "
    )
    assert page.endswith("by `python benchmarks/speed.py`.\n<!-- speed: end -->\n\nAfter.\n")
    assert docs_figures.bare(docs_figures.on_page(SPEED, tmp_path)) == text


def test_marks_without_anything_between_wait_for_a_measurement(docs, tmp_path):
    docs.write_text("<!-- speed: begin -->\n<!-- speed: end -->\n")
    assert told(tmp_path) == []


def test_a_figure_changed_by_hand_a_lost_mark_and_a_stray_one_are_told(docs, tmp_path):
    record = docs_figures.Record("speed", "docs/a.md", SPEED.told, "2026-11-22", "abc1234", "| a |\n|---|\n| 2.5 |")
    docs_figures.write(record, tmp_path)
    docs.write_text(docs.read_text().replace("2.5", "2.4"))
    assert len(told(tmp_path)) == 1
    docs.write_text("<!-- other: begin -->\n<!-- other: end -->\n")
    first, second = told(tmp_path)
    assert first.startswith("docs/a.md: no marks <!-- speed: begin -->")
    assert second == "docs/a.md: 'other' is not in docs_tables.py"
    other = Table("other", "docs/a.md", ("python",))
    assert told(tmp_path, other)[-1] == "docs/figures/speed.json: of no table"


HELD = """| set |  | error [m] |
|---|---|---|
| 1 | filters | 0.0271 |
| 1 | `smoothed` | 0.0202 of 1,524 |
| 2 | | 0.5 |
| 20 | | 0.7 |"""


def held(name):
    return HELD if name == "speed" else None


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("1 filters, error [m]", 0.0271),
        ("1 smoothed, error [m]", 0.0202),
        ("1 smoothed, error [m]#2", 1524.0),
        ("1 filters, error [m] x 1000", 27.1),
        ("1 filters, 3", 0.0271),
        ("2, 3", 0.5),
    ],
)
def test_a_number_is_found_in_its_table(place, value):
    assert docs_prose.look_up(HELD, place) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<!-- figure: speed[1 filters, error [m]] -->0.027 m", None),
        ("<!-- figure: speed[1 filters, error [m]] -->0.0271.", None),
        ("<!-- figure: speed[1 smoothed, error [m]#2] -->1,524", None),
        ("<!-- figure: speed[1 filters, error [m]] -->0.028", "the page says 0.028, the table 0.0271"),
        ("<!-- figure: speed[1 filters, error [m]] -->about", "the page says nothing"),
        ("<!-- figure: speed[1, error [m]] -->0.027", "2 rows begin with '1'"),
        ("<!-- figure: speed[1 filters, time] -->0.027", "no column 'time'"),
        ("<!-- figure: speed[1 filters, error [m]#2] -->0.027", "no number 2"),
        ("as good as\n<!-- figure: speed[1 filters, error [m]] -->0.0271", "begins its line"),
        ("<!-- figure: sped[1 filters, error [m]] -->0.027", "no such table"),
    ],
)
def test_a_number_in_a_sentence_that_its_table_does_not_hold_is_told(docs, tmp_path, text, told):
    docs.write_text(f"It is {text}\n")
    wrong = docs_prose.stale_prose(tmp_path, held)
    assert len(wrong) == (told is not None)
    if told:
        assert wrong[0].startswith("docs/a.md: ")
        assert told in wrong[0]


def test_sentences_follow_a_table_that_is_measured_again(docs, tmp_path):
    (tmp_path / "README.md").write_text(
        "It errs by <!-- figure: speed[1, b] -->0.50 m of <!-- figure: other[1, b] -->9.\n"
    )
    record = docs_figures.Record(
        "speed", "docs/a.md", SPEED.told, "2026-11-22", "abc1234", "| a | b |\n|---|---|\n| 1 | 0.731 |"
    )
    docs_figures.write(record, tmp_path)
    assert (tmp_path / "README.md").read_text().startswith("It errs by <!-- figure: speed[1, b] -->0.73 m of ")
    assert "-->9." in (tmp_path / "README.md").read_text()
    assert [line for line in told(tmp_path) if "speed" in line] == []
