"""`mapweave simulate corridor|office|tunnel`: a log and its truth, the same for the same seed."""

import numpy as np
import pytest

from mapweave.cli import _run
from mapweave.core import se2
from mapweave.io.laser_logs import read_laser
from mapweave.io.tum import read_tum
from mapweave.sim.laser_worlds import OfficeConfig, TunnelConfig, simulate_office, simulate_tunnel

SMALL = {
    "corridor": ["--distance", "8", "--end-error", "0,0"],
    "office": ["--rooms", "1", "--visited", "1"],
    "tunnel": ["--length", "20"],
}


@pytest.mark.parametrize("world", sorted(SMALL))
def test_each_world_writes_a_log_with_intensities_and_its_truth_at_every_stamp(tmp_path, world):
    out = tmp_path / f"{world}.mcap"
    assert _run(["simulate", world, "--out", str(out), "--seed", "3", *SMALL[world]]) == 0
    log, truth = read_laser(out), read_tum(tmp_path / f"{world}.truth.tum")
    assert log.has_intensity
    assert log.warnings == ()
    assert np.allclose(truth.t, log.stamps())
    first = out.read_bytes()
    assert _run(["simulate", world, "--out", str(out), "--seed", "3", *SMALL[world]]) == 0
    assert out.read_bytes() == first


def test_parameters_of_the_world_and_the_drive_are_options(tmp_path):
    out = tmp_path / "c.mcap"
    more = "--width 3 --people 4 --law second --specular 0.5 --beams 100 --range 4 --scan-every 0.5"
    assert (
        _run(
            ["simulate", "corridor", "--out", str(out), *SMALL["corridor"], *more.split(), "--sensor-pose", "0.1,0,0.2"]
        )
        == 0
    )
    log = read_laser(out)
    assert len(log.scans) == 17
    assert len(log.scans[0].ranges) == 100
    assert np.allclose(log.scans[0].T_robot_sensor, [0.1, 0, 0.2])
    assert max(s.ranges[s.hit].max() for s in log.scans) < 4


def test_a_world_or_file_that_cannot_be_is_bad_usage(tmp_path, capsys):
    out = tmp_path / "c.mcap"
    assert _run(["simulate", "corridor", "--out", str(tmp_path / "c.txt")]) == 2
    assert "expected a file name such as corridor.mcap" in capsys.readouterr().err
    assert _run(["simulate", "corridor", "--out", str(out), "--scan-every", "0"]) == 2
    assert "--scan-every: too small" in capsys.readouterr().err
    assert _run(["simulate", "corridor", "--out", str(out), "--falloff", "0"]) == 2
    assert "--falloff: too small" in capsys.readouterr().err
    assert _run(["simulate", "corridor", "--out", str(out), "--specular", "5"]) == 2
    assert "--specular: expected a share from 0 to 1, found 5" in capsys.readouterr().err
    assert _run(["simulate", "corridor", "--out", str(out), "--long-leg", "12"]) == 2
    assert "--start: expected between 1.2 and 10.8 m along a leg of 12 m, found 15" in capsys.readouterr().err
    assert _run(["simulate", "tunnel", "--out", str(out), "--sensor-pose", "1,2"]) == 2
    assert "--sensor-pose: expected 3 numbers" in capsys.readouterr().err
    assert not out.exists()


def test_an_office_robot_keeps_clear_of_walls_and_desks_and_returns_to_its_start():
    for seed in range(4):
        sim = simulate_office(OfficeConfig(visited=8), seed)
        assert min(scan.ranges.min() for scan in sim.log.scans) > 0.15
        assert np.hypot(*(sim.truth.pose[-1] - sim.truth.pose[0])[:2]) < 0.5


def test_a_tunnel_looks_the_same_everywhere_but_for_its_marks():
    sim = simulate_tunnel(TunnelConfig(), 1)
    bright = sim.world.reflectance > 0.8
    assert 20 < bright.sum() < 80
    mid = [k for k, i in enumerate(range(0, len(sim.truth.t), 5)) if 20 < sim.truth.pose[i, 0] < 60]
    lines = []
    for k in mid:
        scan = sim.log.scans[k]
        points = np.column_stack([scan.ranges * np.cos(scan.angles()), scan.ranges * np.sin(scan.angles())])[scan.hit]
        lines.append(np.abs(se2.act(sim.truth.pose[5 * k], points)[:, 1]).max())
    assert np.abs(np.array(lines) - 1.5).max() < 0.25
