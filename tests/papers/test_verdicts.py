"""Verdicts on claims follow from what was measured: other numbers, another word."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.papers.hamatani.experiments import CASES, LAYOUT, VARIANCES, Beyond, Cell, TableCell
from mapweave.papers.hamatani.reproduce import DRIFT, PRINTED, HamataniReproduction, Pictures
from mapweave.papers.reproduction import Check, Rule, Typed, question, rule

ASKED = rule(Check("a", "ours / printed", 0.5, 2.0), Check("b", "wrong", most=0.0))


@pytest.mark.parametrize(
    ("numbers", "word", "open_word"),
    [
        ({"a": [0.5, 1.0, 2.0], "b": [0.0]}, "holds", "answered"),
        ({"a": [0.4, 1.0, 2.1], "b": [0.0]}, "in part", "in part"),
        ({"a": [0.4, 1.0, 2.1], "b": [1.0]}, "does not hold", "not answered"),
        ({"a": [float("nan")], "b": [1.0]}, "does not hold", "not answered"),
        ({"a": [], "b": []}, "does not hold", "not answered"),
    ],
)
def test_all_numbers_as_asked_hold_half_of_them_in_part_and_fewer_do_not(numbers, word, open_word):
    assert ASKED.verdict(numbers) == word
    assert question(*ASKED.checks).verdict(numbers) == open_word


def test_a_rule_says_its_bounds_and_how_many_are_enough():
    assert ASKED.text == "ours / printed 0.5 to 2; wrong ≤ 0"
    most = Rule((Check("a", "error at 25 / at 0", least=1.0),), enough=0.85)
    assert most.text == "error at 25 / at 0 ≥ 1 (85% of them are enough)"
    assert [most.verdict({"a": [2.0] * n + [0.5] * (9 - n)}) for n in (8, 7, 4)] == [
        "holds",
        "in part",
        "does not hold",
    ]
    assert Typed("holds", "a drawing").verdict({}) == "holds"


def _hamatani(factor, far=1.0, over_bound=1.0):
    """What was printed times `factor`, from guesses of 25 m² times `far` too; exact bearings solved."""
    cells = []
    for known in (False, True):
        for g in VARIANCES:
            for b in VARIANCES:
                table = PRINTED[3 if known else 1]
                by = factor * (far if g == VARIANCES[-1] else 1.0)
                side = np.array([by * table[g, b] if b else 1e-12])
                angle = np.array([by * PRINTED[2][g, b] if b else 1e-12])
                cells.append(Cell(TableCell(g, b, known), side, angle))
    drift = tuple(Cell(c, np.array([0.01 if c.form == "fej" else 5.0]), np.ones(1)) for c in DRIFT)
    ones = np.ones(2)
    beyond = tuple(Beyond(c, over_bound * ones, ones, ones, 0 * ones, ones > 0, 0) for c in CASES)
    example = Pictures(LAYOUT, LAYOUT, LAYOUT, LAYOUT, LAYOUT + factor - 1.0, LAYOUT, ())
    return HamataniReproduction(0, False, 10, tuple(cells), drift, beyond, example, {})


def _words(result):
    _, rows = result.claims_table()
    return {claim.here: row[5] for claim, row in zip(result.claims, rows, strict=True)}


def test_hamatanis_words_change_with_the_cells():
    printed, worse, far = _words(_hamatani(1.0)), _words(_hamatani(3.0)), _words(_hamatani(1.0, far=3.0))
    assert [printed[f"table{t}"] for t in PRINTED] == ["holds"] * 3
    assert [worse[f"table{t}"] for t in PRINTED] == ["does not hold"] * 3
    assert (printed["bad_guess"], far["bad_guess"], far["table1"]) == ("holds", "does not hold", "holds")
    assert (printed["angles"], far["angles"]) == ("holds", "in part")
    assert (printed["places"], worse["places"]) == ("holds", "does not hold")
    assert printed["exact"] == "does not hold"
    assert printed["grows"] == "holds"
    assert _words(_hamatani(1.0, over_bound=1.5))["space"] == "in part"


def test_the_word_of_the_drift_is_that_of_both_ways_to_linearise():
    same = _hamatani(1.0)
    held = replace(same, drift=tuple(replace(c, side=np.array([0.01])) for c in same.drift))
    assert (_words(same)["drift"], _words(held)["drift"]) == ("holds", "does not hold")
