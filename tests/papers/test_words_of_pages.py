"""The verdicts on the page of intensity follow from the tables that were measured with them."""

import json
import re
from pathlib import Path

import numpy as np

from mapweave.papers.hara.experiments import AlongRow, AlphaCurve, Bounds, GateRow, LocalisedStart, methods
from mapweave.papers.hara.reproduce import HaraReproduction

FIGURES = Path(__file__).parent.parent.parent / "docs" / "figures"
PLACES = {"the building": "here", "its twin": "twin", "another": "other"}


def rows(name):
    """Cells of a table, its head left out."""
    lines = json.loads((FIGURES / f"hara-{name}.json").read_text(encoding="utf-8"))["table"].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def numbers(row):
    return np.array([float(v) for v in row])


def gate_row(cells):
    pairs = [float(v) for v in re.findall(r"[\d.]+", cells[2])] or [np.nan, np.nan]
    counts = [np.array([float(v or 0)]) for v in cells[5:]]
    return GateRow(cells[0], cells[1], *pairs, np.array([float(cells[3])]), *counts)


def starts():
    told = {"normalised": [], "none": []}
    for world, feature, where, *counts in rows("starts"):
        for answer, count in zip(("right", "wrong", "not sure"), counts, strict=True):
            named = "normalised" if feature == "intensity" else "none"
            if world != "all":
                told[named] += [(world, PLACES[where], named, answer)] * int(count)
    return tuple(
        LocalisedStart(k, *start, None, 0.0, True, "") for named in told.values() for k, start in enumerate(named)
    )


def from_tables():
    alpha = rows("alpha")
    bounds = {row[0].split()[0]: np.array([float(row[1])]) for row in rows("bounds")}
    curve = AlphaCurve(
        tuple(float(row[0]) for row in alpha[:-1]),
        np.array([[float(row[1])] for row in alpha[:-1]]),
        numbers(re.findall(r"[\d.]+", alpha[-1][0])[:1]),
        numbers(alpha[-1][1:2]),
    )
    errors = np.array([numbers(row[2:8]) for row in rows("methods")])
    along = tuple(AlongRow(row[0], numbers(row[1:])) for row in rows("walls"))
    least = Bounds(bounds["geometry"], bounds["intensity"])
    gate = tuple(gate_row(row) for row in rows("gate"))
    return HaraReproduction(0, False, 512, methods(512), errors, (), gate, along, least, curve, starts(), {})


def test_the_words_on_haras_page_follow_from_its_tables():
    _, judged = from_tables().claims_table()
    assert [(row[0], row[5]) for row in judged] == [(cells[0], cells[5]) for cells in rows("claims")]


def test_geometry_is_asked_where_it_started_in_fewer_places_as_it_knows_no_twins():
    *_, last = from_tables().claims_table()[1]
    twins = sum(start.where == "twin" for start in starts())
    with_light, bare = (int(v) for v in re.findall(r"\d+", last[7])[:2])
    assert with_light - bare == twins > 0
