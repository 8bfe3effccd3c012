"""Landmarks without names: how often their identity is found, and that what cannot be told is refused."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion.alignment import align_robust, joint_fit
from mapweave.fusion.identities import IdentityConfig, match_maps
from mapweave.landmarks.landmark_map import LandmarkMap

from .worlds import covariance


def two_maps(rng, common, n=20, size=3.0, sigma=0.01):
    """Two maps of n points in a square with `common` in both, their alignment and the true links."""
    points = rng.uniform(0, size, (2 * n - common, 2))
    order = rng.permutation(n)
    T = np.append(rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi))
    first = points[:n] + rng.normal(0, sigma, (n, 2))
    second = se2.act(T, points[n - common :][order]) + rng.normal(0, sigma, (n, 2))
    names = tuple(str(i) for i in range(n))
    P = sigma**2 * np.eye(2 * n)
    links = {(n - common + i, int(np.flatnonzero(order == i)[0])) for i in range(common)}
    return LandmarkMap(names, first, P), LandmarkMap(names, second, P), T, links


def lies_right(found, T, source):
    return np.hypot(*(se2.act(found, source.mean) - se2.act(T, source.mean)).T).max() < 0.15


@pytest.mark.parametrize("common", [6, *(pytest.param(n, marks=pytest.mark.slow) for n in (8, 14))])
def test_with_six_in_common_or_more_nearly_every_alignment_is_right_and_believed(common):
    right = believed = 0
    for draw in range(20):
        source, target, T, links = two_maps(np.random.default_rng([common, draw]), common)
        match = match_maps(source, target)
        ok = lies_right(match.T_target_source, T, source)
        right += ok
        believed += match.accepted
        assert ok or not match.accepted
        if match.accepted:
            assert len(links & {(int(i), int(j)) for i, j in match.links}) >= common - 2
    assert right >= 19
    assert believed >= (18 if common == 6 else 19)


@pytest.mark.parametrize("common", [4, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 2))])
def test_with_too_few_in_common_a_match_is_refused_with_the_reason(common):
    wrong, reasons = 0, []
    for draw in range(20):
        source, target, T, _ = two_maps(np.random.default_rng([90 + common, draw]), common)
        match = match_maps(source, target)
        wrong += match.accepted and not lies_right(match.T_target_source, T, source)
        if not match.accepted:
            reasons.append(match.reason)
    assert wrong == 0
    assert len(reasons) > 15
    assert all("needed" in r or "another alignment" in r or "chi-square" in r or "chance" in r for r in reasons)


def test_a_regular_grid_fits_in_many_ways_and_is_refused():
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    m = LandmarkMap(tuple("abcdefghijklmnop"), grid, 1e-4 * np.eye(32))
    match = match_maps(m, m)
    assert not match.accepted
    assert "another alignment" in match.reason


def part_of(points, rng, share):
    """A map of the landmarks nearest to one side, but for a few."""
    heading = rng.uniform(-np.pi, np.pi)
    nearest = np.argsort(points @ [np.cos(heading), np.sin(heading)])[: int(share * len(points))]
    at = points[rng.permutation(nearest[rng.random(len(nearest)) > 0.1])]
    names = tuple(map(str, range(len(at))))
    return LandmarkMap(names, at + rng.normal(0, 0.01, at.shape), 1e-4 * np.eye(2 * len(at)))


def place(kind, rng):
    if kind == "grid":
        return np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    if kind == "street":
        return np.stack(np.meshgrid(1.5 * np.arange(14), [0.0, 2.5]), axis=-1).reshape(-1, 2)
    if kind == "rooms":
        room = rng.uniform(0, 2, (7, 2))
        return np.concatenate([room + np.array([3.0 * k, 0.0]) for k in range(4)])
    times, part = {"circle": (20, np.array([[3.0, 0.0]])), "quarters": (4, rng.uniform(-3, 3, (7, 2)))}[kind]
    return np.concatenate([se2.act(np.array([0, 0, 2 * np.pi * k / times]), part) for k in range(times)])


@pytest.mark.parametrize("kind", ["grid", "street", "circle", "rooms", "quarters"])
def test_parts_of_a_place_that_repeats_itself_are_never_laid_on_another(kind):
    """However much likelier the alignment of most links is: it lays a part on another that is alike."""
    for draw in range(20):
        rng = np.random.default_rng([13, draw])
        points, share = place(kind, rng), rng.uniform(0.5, 1.0)
        match = match_maps(part_of(points, rng, share), part_of(points, rng, share))
        assert not match.accepted
        assert match.reason


def test_a_rival_is_found_behind_hundreds_of_hypotheses_of_the_best_alignment():
    points = place("quarters", np.random.default_rng(14))
    m = LandmarkMap(tuple(map(str, range(28))), points, 1e-4 * np.eye(56))
    match = match_maps(m, m)
    assert match.rival == 28
    assert not match.accepted


def test_a_place_that_repeats_little_of_itself_is_matched():
    rng = np.random.default_rng(15)
    pattern = rng.uniform(0, 2, (7, 2))
    points = np.concatenate([pattern, pattern + np.array([6.0, 1.0]), rng.uniform([-1, -4], [8, 0], (10, 2))])
    m = LandmarkMap(tuple(map(str, range(24))), points, 1e-4 * np.eye(48))
    match = match_maps(m, m)
    assert match.accepted
    assert match.rival >= 7
    assert match.rival_evidence > 5


def looking(part):
    """The robot looked where `part` of a point says, and maps all but one in ten of what stands there."""
    return lambda points: 0.9 * part(points).astype(float)


def test_where_robots_looked_is_evidence_for_a_match_and_against_it():
    """Six in common at the border of two maps: alone or in the crowd of what only one of both has."""
    rng = np.random.default_rng(16)
    shared, one, two = (rng.uniform([x, 0], [x + w, 3], (k, 2)) for x, w, k in ((3, 1, 6), (0, 3, 14), (4, 3, 14)))

    def a_map(*parts):
        at = np.concatenate(parts)
        return LandmarkMap(
            tuple(map(str, range(len(at)))), at + rng.normal(0, 0.01, at.shape), 1e-4 * np.eye(2 * len(at))
        )

    source, target = a_map(shared, one), a_map(shared, two)
    mapped = looking(lambda p: p[:, 0] < 4), looking(lambda p: p[:, 0] > 3)
    blind, told = match_maps(source, target), match_maps(source, target, mapped=mapped)
    assert told.accepted
    assert told.evidence > blind.evidence + 5
    everywhere = looking(lambda p: p[:, 0] < 9)
    against = match_maps(source, target, mapped=(everywhere, everywhere))
    assert not against.accepted
    assert against.evidence < blind.evidence - 5
    assert match_maps(source, target, mapped=(everywhere, None)).evidence == blind.evidence


def test_a_mirrored_map_is_not_a_match():
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 3, (12, 2))
    names = tuple("abcdefghijkl")
    m = LandmarkMap(names, points, 1e-4 * np.eye(24))
    mirrored = LandmarkMap(names, points * [1, -1], 1e-4 * np.eye(24))
    assert match_maps(m, m).accepted
    assert not match_maps(m, mirrored).accepted


def test_the_order_of_landmarks_does_not_matter_to_a_match():
    rng = np.random.default_rng(4)
    source, target, _, _ = two_maps(rng, 10)
    once = match_maps(source, target)
    turned = target.select([target.ids[i] for i in rng.permutation(len(target))])
    again = match_maps(source, turned)
    named = {(source.ids[i], target.ids[j]) for i, j in once.links}
    assert named == {(source.ids[i], turned.ids[j]) for i, j in again.links}
    np.testing.assert_allclose(once.T_target_source, again.T_target_source, atol=1e-9)


def test_a_robust_alignment_is_exact_for_clean_points_and_unmoved_by_wrong_ones():
    rng = np.random.default_rng(5)
    points = rng.uniform(-5, 5, (30, 2))
    T = se2.pose(1.0, -2.0, 2.7)
    target = se2.act(T, points)
    target[:12] = rng.uniform(-5, 5, (12, 2))
    fit = align_robust(points, target, np.full(30, 0.2))
    np.testing.assert_allclose(fit.T_target_source, T, atol=1e-9)
    assert fit.inliers[12:].all()
    assert fit.inliers[:12].sum() == 0
    assert fit.median < 1e-9


def test_many_points_are_aligned_from_a_spread_of_their_pairs():
    rng = np.random.default_rng(6)
    points = rng.uniform(-50, 50, (300, 2))
    T = se2.pose(-7.0, 3.0, -1.2)
    target = se2.act(T, points) + rng.normal(0, 0.02, (300, 2))
    target[::3] += 10.0
    fit = align_robust(points, target, np.full(300, 0.2))
    np.testing.assert_allclose(fit.T_target_source, T, atol=0.01)


@pytest.mark.parametrize("scale", [0.96, 1.04])
def test_a_map_whose_scale_is_off_is_matched_where_scales_are_free(scale):
    """Two standard deviations of scale over 14 m: over ten times the gate of maps whose scale is right."""
    rng = np.random.default_rng(11)
    cells = np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2)
    points = 4.0 * cells[rng.permutation(16)[:12]] + rng.uniform(-0.8, 0.8, (12, 2))
    names = tuple("abcdefghijkl")
    P = 0.005**2 * np.eye(24)
    order = rng.permutation(12)
    source = LandmarkMap(names, scale * points, P)
    target = LandmarkMap(names, se2.act(np.array([2.0, -1.0, 2.2]), points[order]), P)
    match = match_maps(source, target)
    assert match.accepted
    assert {(int(order[j]), int(j)) for j in range(12)} == {(int(i), int(j)) for i, j in match.links}
    assert not match_maps(source, target, IdentityConfig(scale_sigma=1e-4)).accepted


def test_a_joint_fit_does_not_depend_on_the_frame_of_the_source():
    rng = np.random.default_rng(12)
    points = rng.uniform(-4, 4, (7, 2))
    names = tuple("abcdefg")
    source = LandmarkMap(names, points, np.diag(np.tile([0.2, 0.01], 7)) ** 2)  # sure in one direction only
    target = LandmarkMap(names, points + rng.normal(0, 0.1, points.shape), covariance(rng, points))
    links = np.stack([np.arange(7)] * 2, axis=1)
    turn = np.array([1.0, -3.0, np.pi / 2])
    once = joint_fit(source, target, links, np.zeros(3), 0.01, 0.02)
    again = joint_fit(source.moved(turn, "x"), target, links, se2.inverse(turn), 0.01, 0.02)
    assert once.chi2 > 5
    assert again.chi2 == pytest.approx(once.chi2, rel=1e-6)
    assert again.scale == pytest.approx(once.scale, rel=1e-9)
    np.testing.assert_allclose(again.single, once.single, rtol=1e-5)
    there = se2.act(again.T, again.scale * se2.act(turn, points))
    np.testing.assert_allclose(there, se2.act(once.T, once.scale * points), atol=1e-7)
