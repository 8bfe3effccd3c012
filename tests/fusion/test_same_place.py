"""Maps of two places that use the same names stay apart; maps of one place are joined; luck is no proof."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.fuse import fuse as fuse_results
from mapweave.api.map_landmarks import map_logs
from mapweave.api.map_options import MapOptions
from mapweave.api.simulate import simulate_landmarks
from mapweave.core import se2
from mapweave.core.errors import ConfigError
from mapweave.fusion import initial_frames
from mapweave.fusion.config import MISLABELLED, FuseConfig
from mapweave.fusion.initial_frames import PlaceTest, same_place
from mapweave.fusion.join import fuse
from mapweave.landmarks.landmark_map import LandmarkMap

from .worlds import covariance, rmse, team, with_landmarks

SIZE, NAMES = 10.0, 15


def two_recordings(rng, same, seen, robots=1, sigma=(0.02, 0.2)):
    """Maps of two teams (`a/..`, `b/..`) that use the same names, in one place or two, and the first place."""
    places = [rng.uniform(-SIZE / 2, SIZE / 2, (NAMES, 2)) for _ in range(2)]
    maps, points = [], None
    for label, truth in zip("ab", [places[0], places[0 if same else 1]], strict=True):
        own, in_first, _, _ = team(rng, robots, NAMES, seen, SIZE, sigma, 0.01, truth)
        maps += [replace(m, robot=f"{label}/{m.robot}") for m in own]
        points = in_first if points is None else points
    return maps, {m.robot: m.robot[0] for m in maps}, points


def mixed(fused):
    return any(len({robot[0] for robot in c.robots}) > 1 for c in fused.components)


def named(n):
    return tuple(str(100 + i) for i in range(n))


def test_no_two_places_of_60_that_use_the_same_names_become_one():
    for draw in range(60):
        rng = np.random.default_rng([1, draw])
        maps, recordings, _ = two_recordings(rng, same=False, seen=int(rng.integers(3, NAMES + 1)))
        fused = fuse(maps, recordings=recordings)
        assert not mixed(fused), draw
        refused = [d for d in fused.decisions if d.decision == "refused"]
        assert [d.robot for d in refused] == ["b/robot1"]
        if len(set(maps[0].submap.ids) & set(maps[1].submap.ids)) > 5:
            assert "contradicts a/robot1" in refused[0].reason


def test_two_recordings_of_one_place_become_one_map():
    for draw in range(40):
        rng = np.random.default_rng([2, draw])
        maps, recordings, points = two_recordings(rng, same=True, seen=10, robots=2)
        fused = fuse(maps, recordings=recordings)
        assert len(fused.components) == 1
        assert [d.decision for d in fused.decisions] == ["reference", "merged", "merged", "merged"]
        assert rmse(fused.components[0], points) < 0.4


@pytest.mark.long
def test_no_two_simulated_teams_become_one_and_each_team_does(tmp_path):
    """210 pairs of 21 worlds through the whole of simulating, mapping and fusing; each world's halves are joined."""
    teams, joined, shared = [], 0, 0
    for seed in range(21):
        folder = tmp_path / f"world{seed}"
        simulate_landmarks(folder, robots=2, minutes=4.0, seed=seed)
        local = map_logs([folder], MapOptions()).local
        if len(set(local[0].submap.ids) & set(local[1].submap.ids)) >= 5:
            apart = fuse(local, recordings={m.robot: m.robot for m in local})
            joined += len(apart.components) == 1
            shared += 1
        teams.append([replace(m, robot=f"{seed}/{m.robot}") for m in local])
    assert joined == shared > 10
    pairs = list(itertools.combinations(teams, 2))
    assert len(pairs) == 210
    for one, two in pairs:
        fused = fuse([*one, *two], recordings={m.robot: m.robot.split("/")[0] for m in (*one, *two)})
        assert all(len({robot.split("/")[0] for robot in c.robots}) == 1 for c in fused.components)


@pytest.mark.slow
def test_results_of_two_rooms_stay_two_maps_and_the_reason_names_landmarks(tmp_path):
    for k in (1, 2):
        simulate_landmarks(tmp_path / f"log{k}", robots=2, landmarks=8, minutes=5.0, seed=k)
        map_logs([tmp_path / f"log{k}"], MapOptions()).write(tmp_path / f"m{k}")
    result = fuse_results([tmp_path / "m1", tmp_path / "m2"])
    assert [m.robots for m in result.maps] == [("m1/robot1", "m1/robot2"), ("m2/robot1", "m2/robot2")]
    assert result.lines()[0].startswith("2 of 4 robots in one map")
    assert all("shared landmarks agree" in d.reason for d in result.fusion.decisions[2:])


def test_labels_exchanged_in_one_recording_do_not_part_it_from_another_of_the_same_place():
    for draw in range(10):
        rng = np.random.default_rng([3, draw])
        maps, recordings, _ = two_recordings(rng, same=True, seen=13, robots=2, sigma=(0.01, 0.05))
        ids = list(maps[3].submap.ids)
        apart = np.hypot(*np.moveaxis(maps[3].submap.mean[:, None] - maps[3].submap.mean, -1, 0))
        a, b = (int(i) for i in rng.permutation(np.argwhere(apart > 1.5))[0])
        ids[a], ids[b] = ids[b], ids[a]
        fused = fuse([*maps[:3], with_landmarks(maps[3], ids)], recordings=recordings)
        assert len(fused.components) == 1
        assert set(fused.labels) == {"b/robot2"}


def test_two_landmarks_in_common_prove_nothing_between_recordings_but_do_within_one():
    rng = np.random.default_rng(4)
    points = rng.uniform(-5, 5, (8, 2))
    maps = [
        LandmarkMap(names, points[list(rows)], 1e-4 * np.eye(2 * len(rows)))
        for names, rows in ((named(5), range(5)), (("103", "104", "105", "106", "107"), range(3, 8)))
    ]
    apart = PlaceTest(maps, ("r1", "r2"), ("a", "b"), FuseConfig())
    together = PlaceTest(maps, ("r1", "r2"), ("a", "a"), FuseConfig())
    assert not apart.joins(0, 1)
    assert together.joins(0, 1)
    reason = apart.evidence(0, 1).reason("r1")
    assert reason == "that the 2 landmarks it shares with r1 (103, 104) agree may be chance"


def test_the_landmarks_that_contradict_are_named_with_their_distances():
    rng = np.random.default_rng(5)
    points = rng.uniform(-5, 5, (10, 2))
    wrong = points.copy()
    wrong[[2, 5, 7]] += [[0.5, 0.0], [0.0, 3.0], [-1.0, 0.0]]
    P = 1e-4 * np.eye(20)
    evidence = same_place(
        LandmarkMap(named(10), se2.act(np.array([3.0, 1.0, 2.0]), wrong), P),
        LandmarkMap(named(10), points, P),
        FuseConfig(),
    )
    assert evidence.contradicting == ("105", "107", "102")
    np.testing.assert_allclose(evidence.distance, [3.0, 1.0, 0.5], atol=1e-3)
    assert evidence.reason("r1") == (
        "contradicts r1: 7 of 10 shared landmarks agree; 102, 105, 107 lie 0.50 to 3.00 m "
        "from where the others put them"
    )


def test_the_evidence_is_the_integral_over_all_transforms(monkeypatch):
    """Against the same Bayes factor summed over a grid of transforms, the scale held at 1."""
    rng = np.random.default_rng(6)
    n = 4
    points = rng.uniform(-3, 3, (n, 2))
    P = covariance(rng, points, sigma=(0.02, 0.1))
    one = LandmarkMap(named(n), points, P)
    shaken = points + (np.linalg.cholesky(P) @ rng.normal(size=2 * n)).reshape(-1, 2)
    T = np.array([0.4, -0.7, 1.1])
    two = LandmarkMap(named(n), se2.act(T, shaken), 0.5 * P)
    cfg = FuseConfig(scale_sigma=1e-5)
    monkeypatch.setattr(initial_frames, "FUSE_DISTRUST", 1.0)
    area = min(2 * np.pi * np.mean(np.sum((m.mean - m.mean.mean(axis=0)) ** 2, axis=1)) for m in (one, two))
    best = se2.align(one.mean, two.mean)
    shift, turn = np.linspace(-1.2, 1.2, 49), np.linspace(-0.5, 0.5, 101)
    density = 0.0
    for theta in turn:
        C = np.kron(np.eye(n), se2.rotation(float(best[2] + theta)))
        V = two.cov + C @ one.cov @ C.T + 2 * cfg.floor**2 * np.eye(2 * n)
        centre = (C @ one.mean.ravel()).reshape(-1, 2)
        offset = two.mean.mean(axis=0) - centre.mean(axis=0)
        x, y = np.meshgrid(shift, shift)
        moves = offset + np.stack([x.ravel(), y.ravel()], axis=1)
        r = (two.mean - centre).ravel() - np.tile(moves, n)
        chi2 = np.einsum("gi,ij,gj->g", r, np.linalg.inv(V), r)
        density += np.exp(-0.5 * chi2).sum() / np.sqrt(np.linalg.det(2 * np.pi * V))
    cell = (shift[1] - shift[0]) ** 2 * (turn[1] - turn[0])
    by_grid = np.log(density * cell / (2 * np.pi * area)) + n * np.log(area) + n * np.log1p(-MISLABELLED)
    assert same_place(one, two, cfg).log_odds == pytest.approx(by_grid, abs=0.05)


def test_the_evidence_depends_on_neither_frame_nor_order():
    rng = np.random.default_rng(7)
    points = rng.uniform(-4, 4, (8, 2))
    one = LandmarkMap(named(8), points, covariance(rng, points))
    two = LandmarkMap(named(8), points + rng.normal(0, 0.03, points.shape), covariance(rng, points))
    there = same_place(one, two, FuseConfig()).log_odds
    moved = same_place(one.moved(np.array([9.0, -4.0, 2.5]), "x"), two, FuseConfig()).log_odds
    assert moved == pytest.approx(there, abs=0.05)
    assert same_place(two, one, FuseConfig()).log_odds == pytest.approx(there, abs=0.3)
    turned = two.select(two.ids[::-1])
    assert same_place(one, turned, FuseConfig()).log_odds == pytest.approx(there, abs=1e-6)


@pytest.mark.parametrize("key", ["scale_sigma", "floor"])
def test_a_threshold_without_meaning_is_refused(key):
    with pytest.raises(ConfigError, match=f"{key}: expected"):
        FuseConfig(**{key: -1.0})
