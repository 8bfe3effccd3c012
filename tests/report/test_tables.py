"""Tables and sentences of a page: numbers of a column can be compared at a glance, and no word is the code's own."""

import re

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.truth import Survey
from mapweave.evaluation.team import as_json, score_team
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.report import team_figures as figures
from mapweave.report.html import Page
from mapweave.report.team import measured
from mapweave.report.team_figures import TeamStory, headline_scores, nees_name
from mapweave.team.team_map import TeamMap


def cells(rows):
    page = Page("Digits")
    page.table(["a"] * len(rows[0]), rows)
    return re.findall(r"<td[^>]*>([^<]*)</td>", page.html())


def test_numbers_of_a_column_have_the_same_decimals_where_they_are_alike():
    assert cells([[0.02335], [0.0673], [0.071]]) == ["0.02335", "0.06730", "0.07100"]
    assert cells([[1.5], [0.25], [None]]) == ["1.500", "0.250", "–"]
    assert cells([[0.0001234], [12.5]]) == ["0.0001234", "12.5"]
    assert cells([[123456.0], [98765.0]]) == ["1.235e+05", "9.876e+04"]
    assert cells([[0.5, 3, "x"]]) == ["0.5", "3", "x"]
    assert cells([[0.0, 2], [0.25, 2], [0.5, 2]]) == ["0.0000", "2", "0.2500", "2", "0.5000", "2"]


def test_words_stand_left_and_numbers_right():
    page = Page("Sides")
    page.table(["robot", "decision", "shared", "sd"], [["1", "merged", "3 of 4", 0.25], ["2", None, "–", None]])
    assert re.findall(r"<th( [^>]*|)>", page.html()) == ["", ' class="word"', "", ""]
    assert page.html().count('<td class="word">') == 2


def test_measurements_are_called_by_what_they_measure():
    told = measured({"robot": 12, "landmark": 1234})
    assert told == "1,234 sightings of landmarks, 12 sightings of robots"


def test_a_score_on_top_of_a_page_has_the_figures_that_there_are():
    told = {"landmark_rmse": None, "mean_ate": 0.04096, "nees_per_dof": 1.234}
    assert [value for _, value in headline_scores(told)] == ["1.23", "0.041 m"]
    assert headline_scores({"relations": {"trans_mean": 0.0339}}) == [("mean error of relations", "0.034 m")]
    assert headline_scores({"relations": {"trans_mean": None}}) == []


@pytest.mark.parametrize("dof", [3, 27, 400])
def test_the_values_called_honest_are_those_of_19_in_20_honest_maps(dof):
    low, high = (float(v) for v in re.findall(r"\d+\.\d", nees_name(dof)))
    drawn = np.random.default_rng(1).chisquare(dof, 20000) / dof
    assert np.mean(drawn < low - 0.05) < 0.025 < np.mean(drawn < low + 0.05)
    assert np.mean(drawn > high + 0.05) < 0.025 < np.mean(drawn > high - 0.05)
    assert nees_name(None).endswith("(honest: 1)")


def test_a_score_is_told_in_words_for_people(tmp_path):
    team = TeamMap((), LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0))))
    score = score_team([team], {}, Survey(("1",), np.zeros((1, 2))), {})
    rows = [(name, 0.5) for name, value in as_json(score).items() if not isinstance(value, list | dict)]
    figures.write_score_report(tmp_path, [], rows, lambda png: figures.draw_bars(png, {}))
    assert not re.findall(r"<td[^>]*>[^<]*_", (tmp_path / "report.html").read_text())


def test_errors_are_drawn_in_the_frame_of_the_map(tmp_path, monkeypatch):
    ids = ("6", "7", "8", "9")
    places = np.array([[0.0, 0.0], [4, 0], [4, 3], [0, 1]])
    moved = se2.act(np.array([100.0, 50.0, 1.0]), places)
    team = TeamMap((), LandmarkMap(ids, places + 0.01, 1e-3 * np.eye(8)))
    score = score_team([team], {}, Survey(ids, moved), {})
    drawn = []
    monkeypatch.setattr(figures.style, "name_points", lambda _, names, points: drawn.append((names, points)))
    story = TeamStory.__new__(TeamStory)
    object.__setattr__(story, "maps", (team,))
    object.__setattr__(story, "truths", {})
    assert "surveyed places" in figures.landmark_errors(tmp_path / "a.png", story, score)
    ((names, points),) = drawn
    assert names == ids
    assert np.allclose(points, places + 0.01, atol=1e-9)
