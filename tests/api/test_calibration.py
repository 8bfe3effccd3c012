"""What is known of robots beforehand, as `--calibration` is told."""

import numpy as np
import pytest

from mapweave.api.map_landmarks import known_calibration
from mapweave.api.map_options import MapOptions
from mapweave.core.errors import UsageError
from mapweave.core.landmark_log import LandmarkLog, SightingTable


def test_a_calibration_of_the_whole_team_serves_some_of_its_robots(tmp_path):
    file = tmp_path / "calibration.json"
    file.write_text('{"1": {"lag": {"value": 0.2}}, "2": {"lag": {"value": 0.3}}}')
    nothing = SightingTable(np.zeros(0), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), ())
    logs = [LandmarkLog("robot1", None, nothing)]
    assert known_calibration(logs, MapOptions(calibration=file, robots=("1",))) == {"robot1": {"lag": (0.2, 0.0)}}
    with pytest.raises(UsageError, match="no robot 2; there are 1"):
        known_calibration(logs, MapOptions(calibration=file))
