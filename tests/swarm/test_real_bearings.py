"""Real bearings: what is biased is found to be, and what is said to be uncertain is."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from angulation import read_angulation

from mapweave.cli import _run
from mapweave.core.errors import ReaderError

pytestmark = pytest.mark.data


def benchmark():
    path = Path(__file__).parents[2] / "benchmarks" / "swarm_real.py"
    spec = importlib.util.spec_from_file_location("swarm_real", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_biased_bearings_are_not_trusted_until_their_bias_is_allowed_for(data):
    found = benchmark().angulation(data / "bearings" / "roh_angulation")
    assert found["bias_largest_deg"] == pytest.approx(8.55, abs=0.1)
    before, held, after = found["cases"].values()
    assert not before["reliable"]
    assert before["nees_per_dof"] > 100.0  # 800 biased readings are taken for 800 independent ones
    assert held["reliable"]
    assert held["nees_per_dof"] < 1.0
    assert after["reliable"]
    assert after["rmse"] < before["rmse"] < 0.12
    assert after["nees_per_dof"] < 3.0
    # The bias common to a place is the heading it was set up with.
    assert np.argmax(np.abs(after["heading_off_deg"])) == 2
    assert after["heading_off_deg"][2] == pytest.approx(-4.6, abs=0.3)


def test_a_folder_without_bearings_is_named(tmp_path):
    with pytest.raises(ReaderError, match="expected files named"):
        read_angulation(tmp_path)


@pytest.mark.slow
def test_robots_that_drive_are_found_from_bearings_of_each_other_and_odometry(data):
    found = benchmark().team(data / "mrclam" / "MRCLAM_Dataset6.zip", seconds=300.0)
    assert found["rmse"] < 0.4
    assert found["rmse"] < 0.7 * found["odometry_alone"]
    assert found["most_pairs_in_a_second"] < found["pairs_needed_at_once"]


def test_a_team_log_is_located_from_the_command_line(data, tmp_path):
    log = data / "mrclam" / "MRCLAM_Dataset6.zip"
    words = ["locate", str(log), "--out", str(tmp_path / "out"), "--truth", str(log), "--sigma", "0.6deg"]
    assert _run([*words, "--until", "100"]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["axis"] is False
    assert "first pose of robot" in metrics["gauge"]
    assert metrics["rmse"] < 1.0
    assert sorted(p.stem for p in (tmp_path / "out" / "trajectories").iterdir()) == ["1", "2", "3", "4", "5"]
