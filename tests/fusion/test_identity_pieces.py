"""The steps of finding common landmarks without names: gates, proposals, assignment, exchanges, and when to refuse."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion.alignment import JointFit, joint_fit
from mapweave.fusion.identities import (
    CHI2_PER_DOF,
    IDENTITY_CHANCE,
    IDENTITY_LINKS,
    IDENTITY_ODDS,
    AlignmentCandidate,
    IdentityConfig,
    _assigned,
    _chance,
    _distinct,
    _exchanged,
    _fits,
    _gates,
    _hypotheses,
    _neighbours,
    _pairs,
    _proposals,
    _refusal,
    _rivals,
    _weighed,
    _worked_out,
    identify,
    match_maps,
)
from mapweave.landmarks.landmark_map import LandmarkMap

CFG = IdentityConfig()
T = np.array([2.0, -3.0, 2.4])


def a_map(points, sigma=0.02):
    sigma = np.broadcast_to(sigma, len(points))
    return LandmarkMap(tuple(map(str, range(len(points)))), np.asarray(points, float), np.diag(np.repeat(sigma**2, 2)))


def two_maps(seed=0, common=8, own=3, scale=1.0, noise=0.01):
    """Two maps of one place, `common` landmarks in both; the second's in another order, turned, `scale` times as large.

    links: which is which.
    """
    rng = np.random.default_rng([seed, 70])
    points = rng.uniform(-5, 5, (common + 2 * own, 2))
    here, there = points[: common + own], np.concatenate([points[:common], points[common + own :]])
    order = rng.permutation(len(there))
    sigma = rng.uniform(0.015, 0.03, (2, common + own))
    source = a_map(here + noise * rng.normal(size=here.shape), sigma[0])
    target = a_map((scale * se2.act(T, there) + noise * rng.normal(size=there.shape))[order], sigma[1])
    links = np.array([(i, int(np.flatnonzero(order == i)[0])) for i in range(common)])
    return source, target, links


def fit(chi2, links):
    return JointFit(np.zeros(3), 1.0, chi2, np.zeros(len(links)))


def test_gates_are_deviations_of_both_maps_and_of_the_scale_away_from_the_middle():
    source, target, _ = two_maps()
    gates = _gates(source, target, CFG)
    middle = source.mean.mean(axis=0)
    for i in range(len(source)):
        for j in range(len(target)):
            both = source.cov[2 * i, 2 * i] + target.cov[2 * j, 2 * j] + 2 * CFG.noise**2
            scaled = (CFG.scale_sigma * np.hypot(*(source.mean[i] - middle))) ** 2
            assert gates[i, j] == pytest.approx(CFG.gate * np.sqrt(both + scaled))
            assert _gates(source, target, CFG, 0.0)[i, j] == pytest.approx(CFG.gate * np.sqrt(both))


@pytest.mark.parametrize(("off", "kept"), [(1.02, True), (0.98, False)])
@pytest.mark.parametrize("sigma", [(0.1, 0.3), (0.3, 0.1)])
def test_pairs_closer_than_three_deviations_of_their_distance_tell_no_direction(sigma, off, kept):
    far = 3 * np.sqrt(np.square(sigma).sum() + 2 * CFG.noise**2)
    i, *_ = _pairs(a_map([[0.0, 0.0], [off * far, 0.0]], np.array(sigma)), CFG)
    assert len(i) == kept


def test_pairs_are_told_with_their_distance_and_its_variance_and_short_ones_are_left_out():
    source, _, _ = two_maps()
    points = np.concatenate([source.mean, source.mean[:1] + np.array([0.05, 0.0])])
    m = a_map(points, 0.02)
    i, j, d, v = _pairs(m, CFG)
    found = {(int(a), int(b)): (x, y) for a, b, x, y in zip(i, j, d, v, strict=True)}
    variance = 2 * (0.02**2 + CFG.noise**2)
    for a in range(len(points)):
        for b in range(a + 1, len(points)):
            apart = np.hypot(*(points[a] - points[b]))
            if apart > 3 * np.sqrt(variance):
                assert found[a, b] == pytest.approx((apart, variance))
            else:
                assert (a, b) not in found
    assert (0, len(source)) not in found


def enumerated(source, target, cfg=CFG):
    """Where every pair laid on every pair as long puts the source's origin -> how long the source's pair is."""
    out = {}
    (i, j, long, u), (k, l, far, v) = _pairs(source, cfg), _pairs(target, cfg)
    for a in range(len(long)):
        for b in range(len(far)):
            if abs(long[a] - far[b]) >= cfg.gate * np.sqrt(u[a] + v[b] + (cfg.scale_sigma * long[a]) ** 2):
                continue
            for p, q in ((k[b], l[b]), (l[b], k[b])):
                s, t = source.mean[[i[a], j[a]]], target.mean[[p, q]]
                angle = np.arctan2(*(t[1] - t[0])[::-1]) - np.arctan2(*(s[1] - s[0])[::-1])
                place = t.mean(axis=0) - se2.rotation(float(angle)) @ s.mean(axis=0)
                out[round(place[0], 6), round(place[1], 6)] = long[a]
    return out


def placed(shift):
    return [(round(z.real, 6), round(z.imag, 6)) for z in shift]


def test_hypotheses_are_every_pair_laid_on_every_pair_as_long_both_ways_round():
    source, target, _ = two_maps(common=4, own=1)
    turn, shift = _hypotheses(source, target, CFG)
    np.testing.assert_allclose(np.abs(turn), 1.0)
    wanted = enumerated(source, target)
    assert set(placed(shift)) == set(wanted)
    assert len(turn) == len(shift) == len(wanted)


@pytest.mark.parametrize(
    ("sigmas", "noise", "scale_sigma"),
    [((0.3, 0.02), 0.0, 1e-3), ((0.02, 0.3), 0.0, 1e-3), ((0.02, 0.02), 0.1, 1e-3), ((0.02, 0.02), 0.0, 0.1)],
)
def test_no_hypothesis_is_overlooked_whatever_makes_the_lengths_unsure(sigmas, noise, scale_sigma):
    cfg = replace(CFG, noise=noise, scale_sigma=scale_sigma)
    rng = np.random.default_rng(6)
    source, target = (a_map(rng.uniform(-4, 4, (7, 2)), sigma * np.geomspace(0.1, 1.0, 7)) for sigma in sigmas)
    turn, shift = _hypotheses(source, target, cfg)
    wanted = enumerated(source, target, cfg)
    assert set(placed(shift)) == set(wanted)
    assert len(turn) == len(wanted) > 20


def test_with_too_many_hypotheses_those_of_the_longest_pairs_are_tried():
    source, target, _ = two_maps()
    all_of_them = len(_hypotheses(source, target, CFG)[0])
    _, few = _hypotheses(source, target, replace(CFG, hypotheses=40))
    assert 2 <= len(few) <= 40 < all_of_them
    long = enumerated(source, target)
    assert min(long[place] for place in placed(few)) > np.quantile(list(long.values()), 0.7)


def test_the_best_proposal_is_the_truth_and_the_others_are_other_places():
    for seed in range(4):
        source, target, _ = two_maps(seed)
        proposals = _proposals(source, target, CFG)
        assert np.abs(se2.between(T, proposals[0])[:2]).max() < 0.3
        assert abs(se2.between(T, proposals[0])[2]) < 0.05
        for a, one in enumerate(proposals):
            for other in proposals[:a]:
                assert _distinct(one, other, source, target, CFG)
    assert _proposals(a_map([[0.0, 0.0]]), target, CFG) == []


def test_alignments_are_distinct_where_they_put_half_the_landmarks_beyond_a_gate():
    source, target, _ = two_maps()
    gate = np.median(_gates(source, target, CFG))
    for share, distinct in ((0.9, False), (1.1, True)):
        moved = se2.compose(T, np.array([share * gate, 0.0, 0.0]))
        assert _distinct(T, moved, source, target, CFG) is distinct


def test_links_are_an_assignment_of_least_squares_within_the_gates():
    rng = np.random.default_rng(1)
    moved, there = rng.uniform(0, 2, (5, 2)), rng.uniform(0, 2, (6, 2))
    gates2 = rng.uniform(0.1, 0.6, (5, 6))
    links = _assigned(moved, there, gates2)
    ratio = np.minimum(np.square(moved[:, None] - there).sum(axis=2) / gates2, 1.0)

    def best(row, free):
        if row == 5:
            return 0.0
        return min(ratio[row, c] + best(row + 1, free - {c}) for c in free)

    assert (ratio[links[:, 0], links[:, 1]] < 1.0).all()
    assert len(set(links[:, 1])) == len(links)
    total = ratio[links[:, 0], links[:, 1]].sum() + (5 - len(links))
    assert total == pytest.approx(best(0, frozenset(range(6))))


def test_neighbours_are_all_exchanges_and_moves_to_free_landmarks_within_twice_the_gates():
    rng = np.random.default_rng(2)
    moved, there = rng.uniform(0, 1.2, (4, 2)), rng.uniform(0, 1.2, (6, 2))
    links, gates = np.array([[0, 1], [1, 3], [2, 0], [3, 5]]), rng.uniform(0.2, 0.4, (4, 6))
    near = np.hypot(*np.moveaxis(moved[:, None] - there, -1, 0)) < 2 * gates
    wanted = set()
    for a in range(4):
        for b in range(a):
            other = links[:, 1].copy()
            other[[a, b]] = other[[b, a]]
            if near[a, other[a]] and near[b, other[b]]:
                wanted.add(tuple(other))
        for free in (2, 4):
            if near[a, free]:
                other = links[:, 1].copy()
                other[a] = free
                wanted.add(tuple(other))
    found = _neighbours(moved, there, links, gates)
    assert {tuple(change[:, 1]) for change in found} == wanted
    assert len(found) == len(wanted) > 3
    assert all((change[:, 0] == links[:, 0]).all() for change in found)


def test_exchanges_end_where_none_makes_chi_square_smaller():
    source, target, links = two_maps(3)
    points = target.mean.copy()
    points[links[1, 1]] = points[links[0, 1]] + [0.09, 0.0]  # two landmarks so near that either may be the other
    mean = source.mean.copy()
    mean[1] = se2.act(se2.inverse(T), points[links[1, 1]])
    source, target = a_map(mean, 0.05), a_map(points, 0.05)
    wrong = links.copy()
    wrong[[0, 1], 1] = links[[1, 0], 1]
    begun = joint_fit(source, target, wrong, T, CFG.noise, CFG.scale_sigma)
    found, better = _exchanged(source, target, wrong, begun, CFG)
    np.testing.assert_array_equal(found, links)
    assert better.chi2 < begun.chi2
    again, same = _exchanged(source, target, found, better, CFG)
    assert again is found
    assert same is better


@pytest.mark.parametrize("scale", [1.0, 1.03])
def test_a_proposal_is_worked_out_to_the_true_links_and_the_scale_between_the_maps(scale):
    for seed in range(3):
        source, target, links = two_maps(seed, scale=scale)
        off = se2.compose(T, np.array([0.1, -0.05, 0.02]))
        off[:2] *= scale
        found, told = _worked_out(source, target, off, CFG)
        assert {tuple(l) for l in found} == {tuple(l) for l in links}
        assert told.scale == pytest.approx(scale, abs=0.01)
        assert told.single.max() <= 18.0


def test_an_alignment_under_which_fewer_than_two_landmarks_meet_stays_what_was_proposed():
    for meet in (0, 1):
        points = np.array([[1.0, 2.0], [4.0, -3.0], [-2.0, 5.0]])
        there = se2.act(T, points) + 30.0 * np.arange(1 - meet, 4 - meet)[:, None]
        links, told = _worked_out(a_map(points), a_map(there), T, CFG)
        assert links.tolist() == [[0, 0]][:meet]
        np.testing.assert_array_equal(told.T, T)
        assert told.scale == 1.0


def test_a_link_that_alone_adds_too_much_is_let_go():
    source, target, links = two_maps(4)
    points = target.mean.copy()
    points[links[2, 1]] += [0.2, 0.0]
    target = LandmarkMap(target.ids, points, target.cov)
    whole = joint_fit(source, target, links, T, CFG.noise, CFG.scale_sigma)
    assert whole.single.argmax() == 2
    assert whole.single.max() > 18.0
    wide = replace(CFG, gate=10.0)
    found, told = _worked_out(source, target, T, wide)
    assert {tuple(l) for l in found} == {tuple(l) for k, l in enumerate(links) if k != 2}
    assert told.single.max() <= 18.0


def candidate(links, chi2, evidence=9.0):
    return AlignmentCandidate(links, fit(chi2, links), evidence)


def test_a_rival_must_fit_and_be_another_alignment():
    links = np.stack([np.arange(5), np.arange(5)], axis=1)
    limit = CHI2_PER_DOF * (2 * 5 - 3)
    assert _fits(candidate(links, 0.99 * limit))
    assert not _fits(candidate(links, 1.01 * limit))
    assert not _fits(candidate(links[:2], 0.0))
    assert _fits(candidate(links[:3], 0.0))
    m = a_map(np.random.default_rng(1).uniform(0, 3, (8, 2)))
    best = candidate(links, 1.0)
    away = JointFit(np.array([2.0, 1.0, 0.7]), 1.0, 1.0, np.zeros(5))
    assert _rivals(AlignmentCandidate(links + np.array([0, 1]), away, 1.0), best, m, m, CFG)
    assert not _rivals(candidate(links + np.array([0, 1]), 1.0), best, m, m, CFG)  # the same alignment
    assert not _rivals(
        AlignmentCandidate(np.vstack([links[:3], links[3:] + np.array([0, 2])]), away, 1.0), best, m, m, CFG
    )


def test_a_match_is_refused_for_too_few_links_a_rival_as_likely_a_misfit_or_as_chance():
    links = np.zeros((7, 2), dtype=int)
    odds, chance = np.log(IDENTITY_ODDS), np.log(IDENTITY_CHANCE)

    def refused(best, count, evidence):
        return _refusal(best, [candidate(links[:count], 1.0, evidence), candidate(links[:6], 1.0, -9.0)], chance)

    good = candidate(links, 10.0, odds + 0.5)
    assert _refusal(good, [], chance) == ""
    assert "are needed" in _refusal(candidate(links[: IDENTITY_LINKS - 1], 9.0, 7.0), [], chance)
    assert _refusal(candidate(links[:IDENTITY_LINKS], 9.0, 6.0), [], chance) == ""
    assert "4 do as well in another alignment" in refused(good, 4, 0.51)
    assert refused(good, 4, 0.49) == ""
    sure = candidate(links, 10.0, 50.0)
    assert "and 4 in another alignment too: the place repeats itself" in refused(sure, 4, chance + 0.01)
    assert refused(sure, 4, chance - 0.01) == ""
    assert refused(sure, 3, chance + 0.01) == ""
    assert _refusal(candidate(links[:6], 10.0, 50.0), [candidate(links[:3], 1.0, 9.0)], chance) == ""
    limit = CHI2_PER_DOF * 11
    assert _refusal(candidate(links, 0.99 * limit, 7.0), [], chance) == ""
    assert "do not fit" in _refusal(candidate(links, 1.01 * limit, 7.0), [], chance)
    assert _chance(candidate(links, 1.0, chance + 0.01), 20, 20, chance) == ""
    assert "may be chance" in _chance(candidate(links, 1.0, chance - 0.01), 20, 20, chance)


def crowded(off, seed=8):
    """Two maps of 20 landmarks, 1 cm sure, that have the first seven in common; the third lies `off` [m] in one."""
    rng = np.random.default_rng(seed)
    block, one, two = (rng.uniform(0, 3, (n, 2)) for n in (7, 13, 13))
    moved = block + np.where(np.arange(7)[:, None] == 2, [off, 0.0], 0.0)
    names, P = tuple(map(str, range(20))), 1e-4 * np.eye(40)
    return LandmarkMap(names, np.vstack([block, one]), P), LandmarkMap(names, se2.act(T, np.vstack([moved, two])), P)


def test_a_link_that_is_no_evidence_is_let_go():
    for off, kept in ((0.01, True), (0.056, False)):
        source, target = crowded(off)
        assert (2, 2) in {tuple(map(int, l)) for l in _worked_out(source, target, T, CFG)[0]}
        assert ((2, 2) in {tuple(map(int, l)) for l in _weighed(source, target, T, CFG).links}) == kept


def test_landmarks_that_agree_in_a_crowd_are_less_evidence_than_the_same_among_few():
    source, target = crowded(0.0)
    crowd = match_maps(source, target)
    alone = match_maps(source.select(source.ids[:7]), target.select(target.ids[:7]))
    seven = {(i, i) for i in range(7)}
    assert seven <= {tuple(map(int, l)) for l in crowd.links}
    assert seven == {tuple(map(int, l)) for l in alone.links}
    assert alone.evidence > crowd.evidence + 5


def test_a_place_that_repeats_itself_is_refused_and_its_rival_counted():
    rng = np.random.default_rng(5)
    block = rng.uniform(0, 3, (6, 2))
    twice = np.concatenate([block, block + np.array([8.0, 0.0])])
    found = match_maps(a_map(block), a_map(se2.act(T, twice)))
    assert not found.accepted
    assert found.rival == len(found.links) == 6
    once = match_maps(a_map(block), a_map(se2.act(T, np.concatenate([block, rng.uniform(8, 11, (6, 2))]))))
    assert once.accepted
    assert once.rival < 6
    assert once.dof == 9


def several(seed, sees):
    """A map of the landmarks `sees[k]` of one place for each robot, in its own frame, order and names."""
    rng = np.random.default_rng([seed, 71])
    points = rng.uniform(-6, 6, (24, 2))
    maps = []
    for k, mine in enumerate(sees):
        order = rng.permutation(mine)
        frame = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-3, 3)])
        at = se2.act(frame, points[order]) + 0.005 * rng.normal(size=(len(order), 2))
        names = tuple(f"{chr(97 + k) if k else ''}{i}" for i in order)
        maps.append(LandmarkMap(names, at, 1e-4 * np.eye(2 * len(order))))
    return maps


def test_landmarks_of_three_maps_have_one_name_each_and_the_others_keep_their_own():
    sees = (range(12), range(4, 16), range(8, 20))
    maps = several(1, sees)
    found = identify(maps, ["one", "two", "three"])
    for k, (before, after) in enumerate(zip(maps, found.maps, strict=True)):
        np.testing.assert_array_equal(after.mean, before.mean)
        for old, new in zip(before.ids, after.ids, strict=True):
            number = int(old.strip("abc"))
            first = next(j for j, mine in enumerate(sees) if number in mine)
            assert new == f"{chr(97 + first) if first else ''}{number}"
            assert found.labels[k].get(old, old) == new
            assert (old in found.labels[k]) == (old != new)
    assert not found.reasons


def test_a_map_that_nobody_shares_keeps_its_landmarks_and_is_told_why_and_equal_names_are_told_apart():
    maps = several(2, (range(10), range(10), range(14, 24)))
    same = [LandmarkMap(tuple(i.strip("abc") for i in m.ids), m.mean, m.cov) for m in maps]
    third = LandmarkMap(tuple(str(k) for k in range(10)), same[2].mean, same[2].cov)
    found = identify([*same[:2], third], ["one", "two", "three"])
    assert set(found.maps[0].ids) == set(found.maps[1].ids) == {str(k) for k in range(10)}
    assert found.maps[0].ids == same[0].ids
    assert set(found.maps[2].ids) == {f"three:{k}" for k in range(10)}
    assert list(found.reasons) == [2]
    assert found.reasons[2].startswith("with one: ")


def test_maps_with_nothing_alike_are_refused_with_the_reason():
    found = match_maps(a_map([[0.0, 0.0], [1.0, 0.0]]), a_map([[0.0, 0.0], [7.0, 0.0]]))
    assert not found.accepted
    assert found.links.shape == (0, 2)
    assert "equally far apart" in found.reason
