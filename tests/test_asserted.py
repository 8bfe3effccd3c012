"""The table of what tests assert holds what they told."""

import asserted


def test_of_several_numbers_told_for_one_statement_the_one_nearest_its_limit_is_printed():
    told = [
        ("a", "< 1", 0.25),
        ("b", "> 100", 440.0),
        ("a", "< 1", 0.5),
        ("b", "> 100", 255.0),
        ("c", "1 .. 2", 1.23456),
    ]
    assert asserted.rows(told) == ["| a | < 1 | 0.500 |", "| b | > 100 | 255 |", "| c | 1 .. 2 | 1.23 |"]


def test_every_file_of_which_numbers_are_told_has_some():
    for name in asserted.FILES:
        assert 'record_property("asserted"' in (asserted.TOP / "tests" / name).read_text(encoding="utf-8")
