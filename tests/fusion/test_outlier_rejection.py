"""Which landmark of which map is wrong: found from the others, put back where labels are exchanged, else made to hardly
count."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion.alignment import RigidFit
from mapweave.fusion.config import FUSE_REFUSE, GATE_SIGMAS, FuseConfig
from mapweave.fusion.initial_frames import (
    Consensus,
    Entries,
    Outlier,
    find_exchanged,
    find_outliers,
    inflated,
    overlaps,
    relabelled,
)
from mapweave.landmarks.landmark_map import LandmarkMap

NAMES = "abcdefgh"
FRAMES = np.array([[0.0, 0.0, 0.0], [3.0, -1.0, 2.0], [-2.0, 4.0, -1.0], [1.0, 2.0, 3.0], [0.5, -4.0, 1.0]])


def places(seed=0):
    rng = np.random.default_rng([seed, 50])
    return {name: 2.0 * np.array(divmod(i, 3), float) + rng.uniform(-0.3, 0.3, 2) for i, name in enumerate(NAMES)}


def maps(views, points, moved=(), exchanged=(), sigma=0.01):
    """Exact maps; moved: (map, name, shift in the common frame); exchanged: (map, name, the label it is given)."""
    out = []
    for k, view in enumerate(views):
        at = {name: points[name].copy() for name in view}
        for owner, name, shift in moved:
            if owner == k:
                at[name] = at[name] + shift
        label = {name: given for owner, name, given in exchanged if owner == k}
        local = se2.act(se2.inverse(FRAMES[k]), np.array([at[name] for name in view]))
        out.append(LandmarkMap(tuple(label.get(n, n) for n in view), local, sigma**2 * np.eye(2 * len(view))))
    return out


def laid(made, cfg=None):
    cluster = Consensus(Entries.of(made), cfg or FuseConfig())
    for k in range(len(made)):
        cluster.place(k, FRAMES[k])
    return cluster


def test_sums_are_those_of_the_entries_that_count_whatever_was_placed_and_dropped():
    points = places()
    made = maps(["abcd", "bcdef", "cdefgh"], points)
    cluster = laid(made)
    cluster.drop(np.array([1, 5]))
    cluster.place(1, FRAMES[1] + [0.1, 0.0, 0.05])  # moved: what did not count does not
    cluster.drop(np.array([1]))
    cluster.add(np.array([5]))
    entries = cluster.entries
    local = np.concatenate([m.mean for m in made])
    turned = [se2.act(cluster.placed[int(k)], p) for k, p in zip(entries.owner, local, strict=True)]
    np.testing.assert_allclose(cluster.position, turned)
    assert np.flatnonzero(~cluster.counts).tolist() == [1]
    for n in range(len(entries.ids)):
        own = (entries.name == n) & cluster.counts
        assert cluster.count[n] == own.sum()
        np.testing.assert_allclose(cluster.total[n], cluster.position[own].sum(axis=0), atol=1e-12)
        assert cluster.variance[n] == pytest.approx(own.sum() * 2e-4)


def test_the_others_place_of_a_landmark_is_their_mean_with_the_variance_of_a_mean():
    made = maps(["abc", "abcd", "bcde"], places(), moved=[(1, "b", np.array([0.3, 0.0]))])
    made[1] = LandmarkMap(made[1].ids, made[1].mean, 4.0 * made[1].cov)
    cluster = laid(made)
    known, place, variance = cluster.others(0)
    points = places()
    assert known.tolist() == [True, True, True]
    np.testing.assert_allclose(place[0], points["a"], atol=1e-9)
    np.testing.assert_allclose(place[1], points["b"] + [0.15, 0.0], atol=1e-9)
    np.testing.assert_allclose(variance, [8e-4, (8e-4 + 2e-4) / 4, (8e-4 + 2e-4) / 4])
    np.testing.assert_allclose(cluster.gates(0, 0.01), GATE_SIGMAS * np.sqrt(variance + 2e-4))
    np.testing.assert_allclose(cluster.gates(0, 7.0), 7.0)
    assert [cluster.shared(k) for k in range(3)] == [3, 4, 3]
    assert cluster.others(2)[0].tolist() == [True, True, True, False]


def test_means_are_of_what_counts_and_of_all_where_nothing_does():
    made = maps(["ab", "abc", "cd"], places(), moved=[(1, "a", np.array([4.0, 0.0]))])
    cluster = Consensus(Entries.of(made), FuseConfig())
    cluster.place(0, FRAMES[0])
    cluster.place(1, FRAMES[1])
    points = places()
    means = cluster.means()
    np.testing.assert_allclose(means[0], points["a"] + [2.0, 0.0], atol=1e-9)
    assert np.isnan(means[3]).all()  # d: held by a map that is not here
    cluster.drop(np.array([2]))
    np.testing.assert_allclose(cluster.means()[0], points["a"], atol=1e-6)
    cluster.drop(np.array([0]))
    np.testing.assert_allclose(cluster.means()[0], points["a"] + [2.0, 0.0], atol=1e-9)


def test_shared_counts_of_pairs_are_of_members_alone():
    entries = Entries.of(maps(["abcd", "bcde", "cdefgh"], places()))
    assert overlaps(entries, [0, 1, 2]).tolist() == [[0, 3, 2], [3, 0, 3], [2, 3, 0]]
    assert overlaps(entries, [0, 2]).tolist() == [[0, 0, 2], [0, 0, 0], [2, 0, 0]]


def test_maps_that_agree_have_no_outliers_and_count_whole():
    cluster = laid(maps([NAMES] * 3, places()))
    assert find_outliers(cluster) == []
    assert cluster.counts.all()


def test_the_landmarks_that_a_map_puts_elsewhere_are_found_worst_first_and_count_no_more():
    shifts = [(2, "e", np.array([1.0, 1.0])), (1, "c", np.array([0.0, -3.0]))]
    cluster = laid(maps([NAMES] * 4, places(), moved=shifts))
    found = find_outliers(cluster)
    assert [(d.owner, d.id, d.alone, d.belongs_to) for d in found] == [(1, "c", False, None), (2, "e", False, None)]
    np.testing.assert_allclose([d.residual for d in found], [3.0, np.sqrt(2.0)], rtol=1e-6)
    entries = cluster.entries
    out = {(int(entries.owner[e]), entries.ids[entries.name[e]]) for e in np.flatnonzero(~cluster.counts)}
    assert out == {(1, "c"), (2, "e")}


@pytest.mark.parametrize(("shift", "found"), [(0.34, 0), (0.36, 1)])
def test_a_landmark_is_doubted_beyond_the_gate_in_metres_or_in_deviations(shift, found):
    moved = [(3, "d", np.array([shift, 0.0]))]
    assert len(find_outliers(laid(maps([NAMES] * 4, places(), moved=moved)))) == found
    unsure = maps([NAMES] * 4, places(), moved=moved, sigma=0.1)  # five deviations are 0.8 m
    assert find_outliers(laid(unsure)) == []


def test_where_two_maps_alone_hold_a_landmark_both_are_doubted():
    cluster = laid(maps([NAMES, NAMES, "abcdefg"], places(), moved=[(1, "h", np.array([2.0, 0.0]))]))
    found = find_outliers(cluster)
    assert sorted((d.owner, d.id, d.alone) for d in found) == [(0, "h", True), (1, "h", True)]
    assert all(d.residual == pytest.approx(2.0) for d in found)
    assert find_exchanged(cluster, found) == found


def test_exchanged_labels_are_told_apart_from_landmarks_that_moved():
    points = places()
    labels = [(2, "b", "f"), (2, "f", "b")]
    moved = [(1, "d", np.array([0.0, 1.0])), (3, "b", np.array([-1.0, 0.5]))]
    cluster = laid(maps([NAMES] * 5, points, moved=moved, exchanged=labels))
    found = find_exchanged(cluster, find_outliers(cluster))
    told = {(d.owner, d.id): d.belongs_to for d in found}
    assert told == {(2, "b"): "f", (2, "f"): "b", (1, "d"): None, (3, "b"): None}


def test_three_labels_that_went_round_are_put_back_and_a_chain_that_stays_open_is_not():
    points = places()
    ring = [(3, "a", "c"), (3, "c", "g"), (3, "g", "a")]
    cluster = laid(maps([NAMES] * 4, points, exchanged=ring))
    found = find_exchanged(cluster, find_outliers(cluster))
    assert {d.id: d.belongs_to for d in found} == {given: name for _, name, given in ring}
    # a is called c; what is called a lies where nothing is: putting a back would leave c twice
    chain = laid(
        maps([NAMES] * 4, points, exchanged=[(3, "a", "c"), (3, "c", "a")], moved=[(3, "c", np.array([9.0, 9.0]))])
    )
    assert {d.belongs_to for d in find_exchanged(chain, find_outliers(chain))} == {None}


def test_two_landmarks_that_both_moved_to_new_places_are_not_called_exchanged():
    shifts = [(2, "a", np.array([-1.0, -1.0])), (2, "h", np.array([1.5, 0.5]))]
    cluster = laid(maps([NAMES] * 4, places(), moved=shifts))
    found = find_exchanged(cluster, find_outliers(cluster))
    assert [(d.owner, d.belongs_to) for d in found] == [(2, None), (2, None)]


def test_a_label_is_put_back_only_where_it_then_lies_less_than_half_as_far_off():
    """Two landmarks half a metre apart, each put between them or beyond: their order is not told by that."""
    points = places()
    points["b"] = points["a"] + [0.5, 0.0]
    shifts = [(1, "a", np.array([0.4, 0.25])), (1, "b", np.array([-0.4, 0.25]))]
    near = laid(maps([NAMES] * 4, points, moved=shifts))
    doubted = find_outliers(near)
    assert len(doubted) == 2
    assert all(d.residual == pytest.approx(np.hypot(0.4, 0.25)) for d in doubted)
    assert {d.belongs_to for d in find_exchanged(near, doubted)} == {None}  # 0.27 m is over half of 0.47 m


def test_exchanged_labels_of_two_maps_are_found_in_each_and_the_doubt_they_threw_on_others_is_lifted():
    """Where two maps alone hold what one has exchanged, both are doubted; the one whose labels fit is let off."""
    points = places()
    cluster = laid(maps(["abcdefgh", "abcdef", "abcdefgh"], points, exchanged=[(2, "g", "h"), (2, "h", "g")]))
    found = find_exchanged(cluster, find_outliers(cluster))
    assert {(d.id, d.belongs_to) for d in found} == {("g", "h"), ("h", "g")}
    assert {d.owner for d in found} == {2}


def test_what_is_doubted_in_one_map_has_no_part_in_an_exchange_of_another():
    points, shift = places(), np.array([1.5, 0.7])
    views = ["abcdefgh", "abcdefg", "bcdefgh", "abcdefgh"]
    swapped = [(2, "c", "d"), (2, "d", "c")]
    made = maps(views, points, moved=[(1, "a", shift), (3, "h", -shift)], exchanged=swapped)
    cluster = laid(made)
    found = {(d.owner, d.id): d for d in find_exchanged(cluster, find_outliers(cluster))}
    assert {key: d.belongs_to for key, d in found.items()} == {
        (1, "a"): None,
        (2, "c"): "d",
        (2, "d"): "c",
        (3, "h"): None,
    }
    assert found[1, "a"].residual == pytest.approx(np.hypot(*shift), abs=0.3)


def test_labels_are_put_back_and_doubted_places_made_to_hardly_count():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    m = LandmarkMap(("a", "b", "c"), rng.normal(size=(3, 2)), root @ root.T, "here")
    wrong = [Outlier(0, "a", 2.0, "b"), Outlier(0, "b", 2.0, "a"), Outlier(0, "c", 3.0)]
    back = relabelled(m, wrong)
    assert back.ids == ("b", "a", "c")
    assert back.frame == "here"
    np.testing.assert_array_equal(back.mean, m.mean)
    np.testing.assert_array_equal(back.cov, m.cov)
    wide = inflated(m, wrong)
    np.testing.assert_allclose(wide.cov - m.cov, np.diag([0, 0, 0, 0, 9.0, 9.0]), atol=1e-12)
    assert wide.ids == m.ids
    assert inflated(m, wrong[:2]) is m


def test_a_map_laid_wrongly_is_laid_over_the_others_again():
    points = places()
    cluster = laid(maps([NAMES] * 3, points))
    cluster.place(1, FRAMES[1] + [0.4, -0.3, 0.2])
    cluster.converge(8)
    relative = se2.between(cluster.placed[0], np.stack([cluster.placed[k] for k in (1, 2)]))
    np.testing.assert_allclose(relative, se2.between(FRAMES[0], FRAMES[1:3]), atol=5e-3)


def test_two_landmarks_in_common_are_needed_to_lay_a_map_over_others():
    made = maps(["abc", "cdef", "defg"], places())
    cluster = Consensus(Entries.of(made), FuseConfig())
    cluster.place(0, FRAMES[0])
    assert cluster.fit(1) is None
    cluster.place(1, FRAMES[1])
    fit = cluster.fit(2)
    np.testing.assert_allclose(fit.T_target_source, FRAMES[2], atol=1e-9)
    assert cluster.agrees(2, fit)


def test_a_map_half_of_whose_shared_landmarks_lie_elsewhere_does_not_agree():
    shift = np.array([5.0, 0.0])
    bad = [(1, name, shift * (i + 1)) for i, name in enumerate("abcde")]
    made = maps([NAMES, NAMES], places(), moved=bad)
    cluster = Consensus(Entries.of(made), FuseConfig())
    cluster.place(0, FRAMES[0])
    assert not cluster.agrees(1, cluster.fit(1))
    good = Consensus(Entries.of(maps([NAMES, NAMES], places(), moved=bad[:3])), FuseConfig())
    good.place(0, FRAMES[0])
    assert good.agrees(1, good.fit(1))


@pytest.mark.parametrize(("off", "agrees"), [(0.45, True), (0.55, False)])
def test_maps_agree_when_the_median_of_what_they_share_lies_within_the_limit(off, agrees):
    cluster = Consensus(Entries.of(maps([NAMES, NAMES], places())), FuseConfig())
    cluster.place(0, FRAMES[0])
    residual = np.array([0.0, 0.1, 0.2, off, off, 3.0, 9.0, 20.0])
    assert FUSE_REFUSE == 0.5
    assert cluster.agrees(1, RigidFit(FRAMES[1], residual, residual < 0.35)) is agrees
