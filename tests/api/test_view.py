"""Opening a result, and what its report holds."""

import re
import webbrowser

import numpy as np
import pytest

import mapweave
from mapweave.api import view as view_module
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.team_map import TeamMap
from mapweave.viewer.base import NullViewer, viewer


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    home = tmp_path_factory.mktemp("view")
    mapweave.simulate_landmarks(home / "team", robots=2, landmarks=10, minutes=1, seed=2)
    made = mapweave.map(home / "team", home / "out", truth=home / "team", fuse_every=20)
    return home / "out", made


def test_the_report_needs_nothing_beside_it_and_tells_every_decision(result):
    folder, made = result
    page = (folder / "report.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    for section in ("Map", "Beside the truth", "Fusion", "Robots", "How the map grew"):
        assert f"<h2>{section}</h2>" in page
    for decision in made.fusion.decisions:
        assert decision.reason.replace("'", "&#x27;") in page
    figures = {p.name for p in (folder / "figures").iterdir()}
    assert page.count("<img") == len(figures)
    assert {"fused_map.png", "landmark_errors.png", "growth.png", "calibration.png", "uncertainty.png"} <= figures
    assert sum(p.stat().st_size for p in (folder / "figures").iterdir()) < 1_500_000


def test_with_a_display_the_report_and_the_viewer_are_opened(result, monkeypatch):
    folder, made = result
    opened, shown = [], []

    class Recorder(NullViewer):
        name = "a viewer"

        def show(self, team, entity="map"):
            shown.append((entity, team.landmarks.ids))

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(view_module, "viewer", lambda **_: Recorder())
    said = mapweave.view(folder)
    assert opened == [(folder / "report.html").resolve().as_uri()]
    assert shown == [("component_1", made.maps[0].landmarks.ids)]
    assert len(said) == 2


def test_a_viewer_that_is_not_wanted_shows_nothing_silently():
    nobody = viewer(wanted=False)
    assert nobody.name == ""
    nobody.show(TeamMap((), LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))))
