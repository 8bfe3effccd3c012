"""The page of a team says first which robots are in its map, who is not and why, and what is in doubt."""

import re

import pytest

import mapweave


def tables(strangers=()):
    """A team's log; the landmarks that `strangers` see have names of their own, and they see no robot."""
    made = mapweave.simulate_landmarks(robots=3, landmarks=8, minutes=2.0, seed=1)
    subject = {code: name for name, code in made.barcodes.items()}
    robots = {r.number for r in made.robots}
    odometry = [(t, r.number, v, w) for r in made.robots for t, v, w in r.odometry.tolist()]
    sightings = []
    for r in made.robots:
        for t, code, seen in zip(r.stamps.tolist(), r.barcodes.tolist(), r.sightings.tolist(), strict=True):
            who = subject.get(code)
            if who is None or (who in robots and (strangers and {who, r.number} & set(strangers))):
                continue
            name = f"robot{who}" if who in robots else f"{who}{'x' * (r.number in strangers)}"
            sightings.append((t, r.number, name, *seen))
    return {
        "odometry": dict(zip(("t", "robot", "v", "w"), map(list, zip(*odometry, strict=True)), strict=True)),
        "sightings": dict(
            zip(("t", "robot", "id", "range", "bearing"), map(list, zip(*sightings, strict=True)), strict=True)
        ),
    }


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    out = tmp_path_factory.mktemp("apart") / "out"
    mapweave.map(out=out, **tables(strangers=(3,)))
    return (out / "report.html").read_text(encoding="utf-8")


def test_who_is_not_in_the_map_is_told_with_the_reason_before_the_map(apart):
    first_screen = apart[: apart.index('<figure class="scene"')]
    assert "<h1>2 maps from" in first_screen
    assert "Robots 1, 2 and 3, in 2 maps that nothing ties together; 2 of 3 in the first." in first_screen
    assert "Not in the first map: robot 3. Why: shares fewer than 2 landmarks with the others." in first_screen
    assert "<h2>Component 2: robot 3</h2>" in apart


def test_rows_of_a_robot_bear_the_colour_of_its_path(apart):
    paths = dict(re.findall(r'"name":"robot (\d)","colour":"(#\w+)"', apart))
    rows = set(re.findall(r'<td><i style="background:(#\w+)"></i>(\d)</td>', apart))
    assert rows == {(colour, robot) for robot, colour in paths.items()}
    assert len(paths) == 3


def test_a_warning_stands_once_below_the_map_and_is_counted_above_it(tmp_path):
    log = tables()
    t = log["odometry"]["t"]
    t[5], t[9] = t[9], t[5]
    mapweave.map(out=tmp_path / "out", **log)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("step back in time") == 1
    assert page.index('href="#warnings"') < page.index('<figure class="scene"') < page.index('id="warnings"')
    assert "all in one map." in page
