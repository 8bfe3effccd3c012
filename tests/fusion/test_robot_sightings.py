"""Robots seen by robots: which sightings are kept, how sure they are, and what they do to the frames."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.fusion import relative
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.fusion.relative import FrameSightings, frame_sightings, fuse_relative, sighting_factor
from mapweave.landmarks.landmark_map import LocalMap, RobotSightings, Submap

SENSOR = {"range_sigma": 0.1, "bearing_sigma": 0.02, "every": 5.0}
TRACKED = {"range_sigma": 0.3, "bearing_sigma": 0.1, "every": 5.0}
FRAMES = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.8]])


def team(seed, sigma=0.05):
    """Two robots with four poor landmarks in common, each driving a circle; robot 1 sees robot 2 once a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 100.0, 0.5)
    points = rng.uniform(-2, 5, (4, 2))
    sightings, maps = [], []
    tracks = [
        np.stack([np.cos(t / 9 + k), np.sin(t / 9 + k), se2.wrap_angle(t / 9 + k + np.pi / 2)], axis=-1) for k in (0, 1)
    ]
    n = np.ones((len(t), 1))
    z = relative.predict(n * FRAMES[0], tracks[0], n * FRAMES[1], tracks[1])
    z += rng.normal(size=z.shape) * [0.1, 0.02]
    sightings = RobotSightings(t[::2], ("2",) * len(t[::2]), z[::2, 0], z[::2, 1])
    for k in (0, 1):
        cov = np.eye(11) * sigma**2
        local = se2.act(se2.inverse(FRAMES[k]), points) + sigma * rng.normal(size=(4, 2))
        submap = Submap(str(k + 1), np.zeros(3), ("a", "b", "c", "d"), local, cov, f"local_{k + 1}")
        track = Track(t, tracks[k], np.tile(1e-6 * np.eye(3), (len(t), 1, 1)), f"local_{k + 1}")
        more = {"robot_sightings": sightings} if k == 0 else {}
        maps.append(LocalMap(str(k + 1), submap, track, {}, **more))
    return maps


def test_sightings_are_thinned_and_those_outside_a_track_are_left_out():
    maps = team(0)
    (told,) = frame_sightings(maps, FRAMES, **TRACKED)
    assert (told.a, told.b) == (0, 1)
    assert len(told.z) == 20
    short = LocalMap("2", maps[1].submap, Track(maps[1].track.t[:40], maps[1].track.pose[:40]), {})
    (fewer,) = frame_sightings([maps[0], short], FRAMES, **TRACKED)
    assert len(fewer.z) == 4
    assert frame_sightings([maps[0]], FRAMES[:1], **TRACKED) == []


def test_the_noise_of_a_sighting_holds_the_uncertainty_of_both_tracks():
    maps = team(1)
    (told,) = frame_sightings(maps, FRAMES, **SENSOR)
    assert np.allclose(told.R[:, 0, 0], 0.1**2 + 2e-6, rtol=1e-6)
    assert (told.R[:, 1, 1] > 0.02**2 + 1e-6).all()


def test_sightings_draw_the_frames_nearer_to_the_truth_and_stay_honest():
    with_them, without, nees = [], [], []
    for seed in range(40):
        maps = team(seed)
        landmarks = [m.submap.landmarks for m in maps]
        plain = fuse_relative(landmarks)
        fused = fuse_relative(landmarks, sightings=frame_sightings(maps, plain.frames, **SENSOR))
        for errors, f in ((without, plain), (with_them, fused)):
            e = f.frames[1] - FRAMES[1]
            e[2] = se2.wrap_angle(e[2])
            errors.append(e)
        nees.append(e @ np.linalg.solve(fused.frame_cov()[1], e) / 3)
    assert np.mean(np.square(with_them)) < 0.5 * np.mean(np.square(without))
    assert np.mean(nees) == pytest.approx(1.0, abs=0.35)


def test_the_term_knows_how_frames_and_scales_move_a_sighting():
    rng = np.random.default_rng(3)
    x = np.r_[0.3, -0.2, 0.5, 4.0, 1.0, -0.7, 1.1, 0.9]
    z = np.array([[4.0, 0.1], [3.0, -0.2]])
    told = FrameSightings(
        0, 1, rng.uniform(-1, 1, (2, 3)), rng.uniform(-1, 1, (2, 3)), z, np.tile(np.eye(2), (2, 1, 1))
    )
    term = sighting_factor(told, np.arange(3), 3 + np.arange(3), (6, 7))
    J = term.jacobian(x)
    for k in range(8):
        d = np.zeros(8)
        d[k] = 1e-5
        assert np.abs(J[:, :, k] - (term.residual(x + d) - term.residual(x - d)) / 2e-5).max() < 1e-8


@pytest.mark.parametrize("weights", ["full-scaled", "full", "diagonal"])
def test_the_front_door_uses_sightings_of_robots_when_told_to(weights):
    plain, told = [], []
    for seed in range(6):
        maps, sure = team(seed, sigma=0.15), []
        for sums, use in ((plain, False), (told, True)):
            (whole,) = fuse(maps, FuseConfig(weights=weights, robot_sightings=use)).components
            e = whole.frames["2"] - FRAMES[1]
            e[2] = se2.wrap_angle(e[2])
            sums.append(e @ e)
            sure.append(np.trace(whole.frame_cov["2"]))
        assert sure[1] < sure[0]
    assert np.mean(told) < 0.8 * np.mean(plain)
