"""The objective's pieces, tours, and what planners promise."""

import itertools

import numpy as np
import pytest

from mapweave.core.records import frozen
from mapweave.exploration.landmarks.belief import Explored
from mapweave.exploration.landmarks.objective import distance_to_hull
from mapweave.kernels.exploration.objective import (
    MotionAndSight,
    expected_uncertainty,
    map_uncertainty,
    mark_half_disc,
    unexplored_cells,
)
from mapweave.kernels.exploration.tours import balanced_tours, greedy_cover
from mapweave.kernels.walls.segments import Raster, Sector
from mapweave.landmarks.landmark_map import Submap
from mapweave.landmarks.submap_slam import Observations, SubmapConfig, move, predict, predicted_observation, update


@pytest.mark.kernel
@pytest.mark.eq("Yuan09:19")
def test_new_cells_are_those_a_look_from_there_would_mark():
    explored = np.zeros((20, 30), dtype=bool)
    explored[:, :12] = True
    poses = np.array([[10.0, 10.0, 0.0], [25.0, 3.0, 2.0], [10.0, 10.0, np.pi]])
    counted = unexplored_cells(explored, poses, Sector(6.0, np.pi / 2), Raster(frozen(np.zeros(2)), 1.0))
    for pose, n in zip(poses, counted, strict=True):
        after = explored.copy()
        mark_half_disc(after, pose, Sector(6.0, np.pi / 2), Raster(frozen(np.zeros(2)), 1.0))
        assert after.sum() - explored.sum() == n
    assert counted[0] > 20
    assert counted[2] == 0


@pytest.mark.kernel
@pytest.mark.eq("Yuan09:17", "Yuan09:18")
def test_expected_uncertainty_is_that_of_a_filter_that_sees_what_is_in_view():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(7, 7)) * 0.05
    m = Submap(
        "r", np.array([0.0, 0.0, 0.2]), ("0", "1"), np.array([[5.0, 1.0], [-6.0, 0.0]]), A @ A.T + 1e-4 * np.eye(7), "l"
    )
    cfg = SubmapConfig(association="known")
    controls = np.array([[1.0, 0.5], [2.0, -1.0]])
    model = MotionAndSight(cfg.period, cfg.Q, cfg.R, Sector(cfg.reach, cfg.half_angle))
    got = expected_uncertainty(m.pose, m.mean, m.cov, controls, model)
    for u, C in zip(controls, got, strict=True):
        p = predict(m, u, cfg)
        z = predicted_observation(p.pose, p.mean[:1])
        want, _ = update(p, Observations(z, ("0",)), cfg)
        eig = np.linalg.eigvalsh
        dense = np.pi * np.sqrt(np.prod(eig(want.cov[:3, :3])))
        dense += sum(np.pi * np.sqrt(np.prod(eig(want.cov[k : k + 2, k : k + 2]))) for k in (3, 5))
        assert abs(C - dense) < 1e-9 * dense
    assert map_uncertainty(np.zeros((3, 3))) == 0.0


def test_distance_to_a_hull_is_signed_and_works_for_a_segment_and_a_point():
    square = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])
    assert np.allclose(distance_to_hull(square, np.array([[2.0, 2], [6, 2], [7, 8], [2, 1]])), [-2, 2, 5, -1])
    assert np.allclose(distance_to_hull(np.array([[0.0, 0], [4, 0]]), np.array([[2.0, 3], [7, 4]])), [3, 5])
    assert np.allclose(distance_to_hull(np.array([[1.0, 1]]), np.array([[4.0, 5]])), [5])


@pytest.mark.kernel
def test_discs_cover_every_cell():
    cells = np.argwhere(np.ones((12, 9))) + 0.5
    chosen = greedy_cover(cells, np.linspace(1, 11, 6), np.linspace(1, 8, 4), 4.0)
    d = np.linalg.norm(cells[:, None] - chosen[None], axis=-1)
    assert d.min(axis=1).max() <= 4.0
    assert len(chosen) < 10


@pytest.mark.kernel
def test_tours_of_few_places_are_as_short_as_the_best_of_all():
    rng = np.random.default_rng(1)

    def length(first, between, last, tour, r):
        if not tour:
            return 0.0
        legs = sum(between[a, b] for a, b in itertools.pairwise(tour))
        return first[r, tour[0]] + legs + last[r, tour[-1]]

    def cost(lengths):
        return max(lengths) + 0.3 * sum(lengths)

    for closed in (False, True):
        places, starts = rng.uniform(0, 50, (5, 2)), rng.uniform(20, 30, (2, 2))
        first = np.linalg.norm(places[None] - starts[:, None], axis=-1)
        between = np.linalg.norm(places[None] - places[:, None], axis=-1)
        last = first.copy() if closed else np.zeros_like(first)
        tours, counts = balanced_tours(first, between, last, 0.3)
        ours = [list(tours[r, : counts[r]]) for r in range(2)]
        assert sorted(ours[0] + ours[1]) == list(range(5))
        best = np.inf
        for owner in itertools.product(range(2), repeat=5):
            groups = [[i for i in range(5) if owner[i] == r] for r in range(2)]
            best = min(
                best,
                cost(
                    [
                        min(length(first, between, last, t, r) for t in itertools.permutations(groups[r]))
                        for r in range(2)
                    ]
                ),
            )
        assert cost([length(first, between, last, ours[r], r) for r in range(2)]) <= 1.03 * best


def test_cells_only_a_lost_submap_had_seen_are_released():
    ex = Explored.over(np.zeros(2), np.array([4.0, 3.0]), robots=2)
    ex.backlog[0, 0, 0] = ex.backlog[1, 0, 1] = ex.backlog[1, 2, 2] = True
    assert not ex.team().any()
    assert ex.known_to(1)[2, 2]
    ex.deliver(0)
    ex.deliver(1)
    ex.fuse(0)
    ex.backlog[1, 0, 0] = True
    ex.lose(1)
    assert ex.team().sum() == 1
    assert ex.team()[0, 0]


def test_motion_of_many_controls_is_each_controls_motion():
    pose, controls = np.array([1.0, 2.0, 0.5]), np.array([[1.0, 0.3], [2.0, -0.1]])
    assert np.allclose(move(pose, controls, 0.5), [move(pose, u, 0.5) for u in controls])
