"""Real processes, killed and started again: the map is the one that `map` makes of the same logs, to the byte."""

import json
import sqlite3
import time
from contextlib import closing

import pytest

from .processes import same_result


@pytest.mark.drawn
@pytest.mark.slow
def test_a_team_that_drives_gives_the_map_of_its_logs_whoever_is_killed_meanwhile(fleet, direct):
    fleet.map()
    fleet.robot("r1")
    fleet.robot("r2")
    fleet.hears("map", "r1: joined")
    fleet.hears("map", "r2: joined")
    fleet.kill("r2")
    fleet.robot("r2")
    fleet.hears("r2", "goes on after")
    fleet.kill("map")
    time.sleep(0.5)
    fleet.map()
    for name in ("map", "r1", "r2"):
        assert fleet.wait(name) == 0, fleet.said(name)
    same_result(direct, fleet.folder / "out-map")
    assert "1 map processes have all of them" in fleet.said("r2")


@pytest.mark.slow
def test_a_robot_under_a_taken_name_is_told_at_its_terminal_at_the_station_and_in_the_result(fleet):
    fleet.map(robots="r1,r2,twin")
    fleet.robot("r1", rate="inf")
    assert fleet.wait("r1") == 0, fleet.said("r1")
    fleet.robot("twin", "--robot", "1", rate="inf", linger="3")
    assert fleet.wait("twin") == 1, fleet.said("twin")
    assert "not used by map process map: message 0: name taken: r1 is robot1 already" in fleet.said("twin")
    fleet.robot("r1", "--robot", "2", "--fresh", rate="inf", linger="3")
    assert fleet.wait("r1") == 1, fleet.said("r1")
    assert "not used by map process map: it has another history under this name" in fleet.said("r1")
    fleet.robot("r2", rate="inf")
    assert fleet.wait("map") == 0, fleet.said("map")
    metrics = json.loads((fleet.folder / "out-map" / "metrics.json").read_text())
    told = [row["text"] for row in metrics["findings"] if row["code"] == "network-told"]
    assert metrics["verdict"] == "doubtful"
    assert any("twin: message 0: name taken" in text for text in told)
    assert any("r1: other history" in text for text in told)


@pytest.mark.long
def test_robots_drive_with_nobody_listening_and_a_map_that_comes_late_gets_the_past(fleet, direct):
    assert fleet.robot("r1", rate="inf", linger="0.5").wait(240) == 0
    assert "0 map processes have all of them" in fleet.said("r1")
    fleet.map()
    fleet.robot("r1")
    fleet.robot("r2", rate="inf")
    fleet.hears("r1", "goes on after")
    assert fleet.wait("map") == 0, fleet.said("map")
    same_result(direct, fleet.folder / "out-map")


@pytest.mark.slow
def test_a_map_process_hands_the_past_of_a_robot_that_left_to_another(fleet, direct):
    fleet.map(robots="r1,r2,r3")  # waits on for one that never comes
    fleet.robot("r1", rate="inf")
    fleet.robot("r2", rate="inf")
    assert fleet.wait("r1") == fleet.wait("r2") == 0
    fleet.start("late", "map", "--out", "out-late", "--name", "late", "--robots", "r1,r2", "--connect", fleet.at)
    assert fleet.wait("late") == 0, fleet.said("late")
    same_result(direct, fleet.folder / "out-late")
    fleet.interrupt("map")
    assert fleet.wait("map") == 0, fleet.said("map")
    same_result(direct, fleet.folder / "out-map")


def damaged_in_the_middle(path):
    """One page amid the file holds nothing, as after a fault of the disk."""
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2 // 4096 * 4096)
        file.write(bytes(4096))


@pytest.mark.slow
def test_stores_damaged_in_the_middle_are_told_and_filled_again_and_the_map_is_the_same(fleet, direct):
    fleet.map(robots="r1,r2,r3")  # waits on for one that never comes
    for name in ("r1", "r2"):
        fleet.robot(name, rate="inf")
        fleet.hears("map", f"{name}: joined")
        assert fleet.wait(name) == 0
    fleet.kill("map")
    for path in (fleet.folder / "out-map.sqlite", fleet.folder / "mapweave-live" / "team-r2.sqlite"):
        with closing(sqlite3.connect(path)) as left:
            left.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        damaged_in_the_middle(path)
    fleet.map()
    fleet.robot("r1", rate="inf")
    fleet.robot("r2", rate="inf")
    assert fleet.wait("map") == 0, fleet.said("map")
    for name, lost in (("map", "what is missing is asked for again"), ("r2", "goes on after")):
        assert "was damaged" in fleet.said(name)
        assert lost in fleet.said(name)
    same_result(direct, fleet.folder / "out-map", but=("metrics.json", "report.html", "result.npz"))  # they tell that
    told = (fleet.folder / "out-map" / "metrics.json").read_text()
    assert "out-map.sqlite was damaged" in told
