"""One submap found in another without a guess: exactly what trying everything finds, the same from either side."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.laser.place_search import FULL
from mapweave.kernels.mapping.places import Clouds, heading_peaks
from mapweave.laser.place_search import likelihood_field
from mapweave.laser.scan_matching import BINS
from mapweave.mapping import places
from mapweave.mapping.places import FIELD, PlaceIndex, PlaceMatch, PlaceSearchConfig
from mapweave.mapping.submaps import SUBMAP_POINTS, PlaceSubmap, make_submap, middles, signature, way_of


def room(seed, boxes=9, size=9.0):
    """Points of walls: a room that no heading and no shift maps onto itself."""
    rng = np.random.default_rng(seed)
    points = []

    def wall(a, b):
        n = max(2, int(np.hypot(*np.subtract(b, a)) / 0.05))
        along = np.linspace(0.0, 1.0, n)[:, None]
        points.append(np.asarray(a) + along * np.subtract(b, a))

    w, h = size, 0.7 * size
    corners = [(-w, -h), (w, -h), (w, h), (0.3 * w, h), (0.3 * w, 0.6 * h), (-w, 0.6 * h)]
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        wall(a, b)
    for _ in range(boxes):
        x, y, turn, side = *rng.uniform(-0.8, 0.8, 2) * (w, h), rng.uniform(0, np.pi), rng.uniform(0.3, 1.2)
        box = se2.act(np.array([x, y, turn]), side * np.array([[0, 0], [1, 0], [1, 0.6], [0, 0.6]]))
        for a, b in zip(box, np.roll(box, -1, axis=0), strict=True):
            wall(a, b)
    return np.concatenate(points)


def seen_from(pose, points, q=None, noise=0.01, seed=0, anchor=0):
    """The submap of one keyframe at `pose`."""
    rng = np.random.default_rng(seed)
    back = se2.inverse(np.asarray(pose, float))
    p = se2.act(back, points) + rng.normal(0.0, noise, points.shape)
    made = make_submap(anchor, anchor, np.zeros((1, 3)), [p], None if q is None else [q])
    assert made is not None
    return made


def found(old, new, cfg=None):
    index = PlaceIndex(cfg)
    index.add(old)
    index.add(new)
    return index.search(1, [0])


@pytest.mark.parametrize("seed", range(6))
def test_a_submap_is_found_wherever_it_is_seen_from_again(seed):
    points = room(seed)
    rng = np.random.default_rng(100 + seed)
    a = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi)])
    b = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi)])
    (match,) = found(seen_from(a, points, seed=1), seen_from(b, points, seed=2))
    error = se2.between(se2.between(a, b), match.measured)
    assert np.hypot(*error[:2]) < 0.03
    assert abs(error[2]) < 0.005
    assert error @ match.information @ error < 16.27
    assert match.share > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_from_either_side_the_same_is_found(seed):
    points = room(seed)
    old = seen_from([1.0, -1.0, 0.4], points, seed=1)
    new = seen_from([-1.5, 0.5, 2.0], points, seed=2)
    (one,), (other,) = found(old, new), found(new, old)
    assert np.abs(se2.compose(one.measured, other.measured)).max() < 0.03


def test_another_room_is_no_place_of_this_one():
    for seed in range(8):
        one, other = room(seed), room(seed + 50, size=6.0)
        assert found(seen_from([0, 0, 0.3], one), seen_from([0, 0, 1.0], other)) == []


def test_a_bare_corridor_is_refused_since_nothing_holds_it_along_itself():
    x = np.arange(-12.0, 12.0, 0.05)
    points = np.concatenate([np.column_stack([x, np.full_like(x, y)]) for y in (-1.0, 1.0)])
    assert found(seen_from([0, 0, 0], points), seen_from([3.0, 0, 0], points)) == []


def test_light_on_the_walls_of_a_bare_corridor_tells_where_along_it_a_submap_lies():
    rng = np.random.default_rng(4)
    x = np.arange(-16.0, 16.0, 0.05)
    points = np.concatenate([np.column_stack([x, np.full_like(x, y)]) for y in (-1.0, 1.0)])
    q = np.repeat(rng.uniform(0.2, 1.0, len(points) // 8), 8)
    old, new = (seen_from([at, 0.0, 0.0], points, q, seed=k) for k, at in enumerate((0.0, 2.0)))
    (match,) = found(old, new)
    assert np.abs(match.measured - [2.0, 0.0, 0.0]).max() < 0.05
    assert match.covariance[0, 0] > 0.05**2  # what light leaves open
    even = [seen_from([at, 0.0, 0.0], points, np.full(len(points), 0.6)) for at in (0.0, 2.0)]
    assert found(*even) == []


def lit_corridor(reflectance):
    """Two bare walls 2 m apart along x, of `reflectance` at each 0.4 m of either."""
    x = np.arange(-16.0, 16.0, 0.05)
    points = np.concatenate([np.column_stack([x, np.full_like(x, y)]) for y in (-1.0, 1.0)])
    return points, np.repeat(reflectance, 8)


@pytest.mark.parametrize("there", [[2.05, 0.5, np.pi], [-3.5, -0.5, 0.0], [6.02, 0.4, np.pi]])
def test_light_tells_the_way_back_along_a_bare_corridor_from_the_way_there(there):
    points, q = lit_corridor(np.random.default_rng(6).uniform(0.2, 1.0, 160))
    old, new = seen_from([0.0, -0.5, 0.0], points, q, seed=1), seen_from(there, points, q, seed=2)
    (match,) = found(old, new)
    error = se2.between(se2.between(np.array([0.0, -0.5, 0.0]), np.array(there)), match.measured)
    assert np.abs(error[:2]).max() < 0.06
    assert abs(error[2]) < 0.02
    sd = np.sqrt(np.linalg.eigvalsh(match.covariance[:2, :2]))
    assert 0.05 < sd[1] < 0.12
    assert sd[0] < 0.04


def test_light_that_repeats_itself_along_a_bare_corridor_tells_no_place():
    once = np.random.default_rng(7).uniform(0.2, 1.0, 10)
    points, q = lit_corridor(np.tile(once, 16))  # the same every 4 m
    assert found(seen_from([0, 0, 0], points, q, seed=1), seen_from([1.0, 0, 0], points, q, seed=2)) == []


def test_light_of_other_walls_tells_no_place_of_these():
    rng = np.random.default_rng(8)
    for seed in range(4):
        one, other = lit_corridor(rng.uniform(0.2, 1.0, 160)), lit_corridor(rng.uniform(0.2, 1.0, 160))
        assert found(seen_from([0, 0, 0], *one, seed=seed), seen_from([1.0, 0, 0], *other, seed=seed)) == []


def scanned(field, points, turns, reach):
    """Best of every heading and shift, by trying them all: (score, heading, x, y)."""
    level0 = field.tables[0]
    pad = 2 ** (len(field.tables) - 1) - 1
    best = (-1, 0, 0, 0)
    for a, turn in enumerate(turns):
        at = np.floor((se2.act(np.array([0.0, 0.0, turn]), points) - field.origin) / FIELD.cell).astype(int)
        for oy in range(-reach, reach + 1):
            for ox in range(-reach, reach + 1):
                c, r = at[:, 0] + ox + pad, at[:, 1] + oy + pad
                inside = (c >= 0) & (r >= 0) & (c < level0.shape[1]) & (r < level0.shape[0])
                score = int(level0[r[inside], c[inside]].astype(int).sum())
                if score > best[0]:
                    best = (score, a, ox, oy)
    return best


@pytest.mark.kernel
def test_the_search_finds_what_trying_every_shift_at_every_heading_finds():
    rng = np.random.default_rng(5)
    for trial in range(6):
        wall, query = rng.uniform(-3, 3, (60, 2)), rng.uniform(-2, 2, (25, 2))
        field = likelihood_field(wall, None, FIELD)
        turns = np.sort(rng.uniform(0, 2 * np.pi, 3))
        reach = 9
        clouds = Clouds(query, np.zeros(len(query), np.int64), np.array([0, len(query)]))
        (row,) = places._search(field, clouds, turns[None], np.array([3]), reach, 0.05)
        score, a, ox, oy = scanned(field, query, turns, reach)
        assert row[3] == pytest.approx(score / (255 * len(query))), trial
        assert np.allclose(row[:3], [ox * FIELD.cell, oy * FIELD.cell, turns[a]])
        assert row[7] <= row[3]


@pytest.mark.kernel
def test_peaks_stand_apart_and_are_a_share_of_the_first_at_least():
    correlation = np.zeros((3, BINS))
    for at, top in ((10, 0.8), (14, 0.7), (100, 0.5), (200, 0.2)):
        correlation[0, at] = top
    correlation[1, 50] = 0.3
    correlation[2, 0], correlation[2, -1], correlation[2, 1] = 0.9, 0.6, 0.6
    turns, count = heading_peaks(correlation, 4, 8, 0.3, 0.35)
    assert count.tolist() == [2, 0, 1]
    assert np.allclose(turns[0, :2] * BINS / (2 * np.pi), [10, 100], atol=0.5)
    assert turns[2, 0] == 0.0


def test_the_signature_turns_with_the_submap():
    points = room(3)
    flat = signature(points, -points)
    there = se2.act(np.array([0.0, 0.0, 0.5]), points)
    turned = signature(there, -there)
    correlation = np.fft.irfft(turned * np.conj(flat), BINS)
    assert abs(int(np.argmax(correlation)) * 2 * np.pi / BINS - 0.5) < 0.03
    assert correlation.max() > 0.9
    assert np.linalg.norm(np.fft.irfft(flat, BINS)) == pytest.approx(1.0)


def test_of_a_selection_the_same_is_found_under_its_own_numbers():
    rooms = [room(k, size=9.0 - 2.0 * k) for k in range(3)]
    index = PlaceIndex()
    for k in (0, 1, 2):
        index.add(seen_from([0.5, 0.0, 0.2], rooms[k]))
    new = seen_from([-0.5, 0.3, 1.0], rooms[1], seed=7)
    number = index.add(new)
    (match,) = index.search(number, range(number))
    assert match.first == 1
    fewer = index.select([1, 2, number])
    (again,) = fewer.search(2, range(2))
    assert (again.first, again.second) == (0, 2)
    assert np.array_equal(again.measured, match.measured)
    copy = index.copy()
    copy.add(new)
    assert len(copy) == len(index) + 1


def test_what_a_setting_forbids_is_not_found():
    points = room(1)
    old, new = seen_from([4.0, 0, 0], points), seen_from([-4.0, 0, 0], points)
    assert len(found(old, new)) == 1
    assert found(old, new, PlaceSearchConfig(reach=5.0)) == []
    assert found(old, new, PlaceSearchConfig(least_share=1.01)) == []
    assert found(old, new, PlaceSearchConfig(least_held=1e6)) == []
    assert found(old, new, PlaceSearchConfig(least_score=1.01)) == []


@pytest.mark.parametrize("seed", range(4))
def test_where_it_is_known_about_how_a_submap_lies_it_is_found_there_and_nowhere_else(seed):
    points, rng = room(seed), np.random.default_rng(seed)
    a, b = np.array([2.0, 1.0, 0.4]), np.array([-2.0, 0.5, 2.0])
    part = points[np.hypot(*(points - b[:2]).T) < 5.0]  # of what the old one saw this is less than half
    index = PlaceIndex()
    rules = PlaceSearchConfig(least_heading=0.0, least_score=0.25, least_share=0.25, least_held=5.0)
    index.add(seen_from(a, points, seed=1))
    index.add(seen_from(b, part, seed=2))
    true = se2.between(b, a)
    guess = se2.compose(true, rng.uniform(-1.0, 1.0, 3) * [0.4, 0.4, 0.3])
    match = index.lay(0, 1, se2.inverse(guess), np.array([0.8, 0.8, 0.6]), rules)
    assert match is not None
    assert (match.first, match.second, match.clear) == (1, 0, True)
    error = se2.between(true, match.measured)
    assert np.hypot(*error[:2]) < 0.05
    assert abs(error[2]) < 0.02
    far = se2.compose(true, np.array([40.0, 0.0, 0.0]))
    assert index.lay(0, 1, se2.inverse(far), np.array([0.8, 0.8, 0.6]), rules) is None
    strict = PlaceSearchConfig(least_share=1.01)
    tried = index.lay(0, 1, se2.inverse(guess), np.array([0.8, 0.8, 0.6]), strict)
    assert tried is None or not tried.clear


def test_where_a_submap_fits_twice_near_where_it_should_lie_neither_is_clear():
    x = np.arange(-12.0, 12.0, 0.05)
    walls = [np.column_stack([x, np.full_like(x, y)]) for y in (-1.0, 1.0)]
    posts = [np.column_stack([np.full(8, p), np.linspace(1.0, 1.4, 8)]) for p in np.arange(-10.5, 11.0, 1.5)]
    points = np.concatenate([*walls, *posts])
    index = PlaceIndex()
    rules = PlaceSearchConfig(least_heading=0.0, least_score=0.25, least_share=0.25, least_held=1.0)
    index.add(seen_from([0.0, 0.0, 0.0], points, seed=1))
    index.add(seen_from([0.7, 0.0, 0.0], points, seed=2))
    match = index.lay(1, 0, np.array([-0.7, 0.0, 0.0]), np.array([2.5, 2.5, 0.3]), rules)
    assert match is not None
    assert not match.clear


def test_submaps_stand_along_the_way_and_every_segment_has_one():
    way = way_of(np.column_stack([0.5 * np.arange(41.0), np.zeros(41), np.zeros(41)]))
    assert way[-1] == pytest.approx(20.0)
    assert np.allclose(way[middles(way)], [1.5, 4.5, 7.5, 10.5, 13.5, 16.5, 19.5])
    assert middles(way[:3]) == [1]
    assert middles(way[:1]) == [0]
    turning = np.column_stack([np.zeros(5), np.zeros(5), 0.5 * np.arange(5.0)])
    assert way_of(turning)[-1] == pytest.approx(0.3 * 2.0)


def test_too_little_seen_makes_no_submap():
    assert make_submap(0, 0, np.zeros((1, 3)), [np.ones((5, 2))], None) is None


def test_a_submap_keeps_little_memory():
    made: PlaceSubmap = seen_from([0, 0, 0], room(0))
    assert made.points.nbytes + made.signature.nbytes + made.thin.nbytes < 32 * 1024
    assert FULL * 255 * SUBMAP_POINTS < 2**31


def test_a_place_told_from_its_other_end_has_the_covariance_of_the_same_errors():
    sd = np.array([[0.03, 0.0, 0.0], [0.02, 0.05, 0.0], [-0.01, 0.01, 0.02]])
    told = PlaceMatch(
        3, 5, np.array([2.0, -1.0, 0.7]), sd @ sd.T, 0.8, 0.1, 0.7, (50.0, 90.0), np.array([np.cos(0.4), np.sin(0.4)])
    )
    turned = told.inverse()
    assert (turned.first, turned.second) == (5, 3)
    np.testing.assert_allclose(se2.compose(told.measured, turned.measured), 0.0, atol=1e-12)
    errors = 1e-4 * np.random.default_rng(1).standard_normal((200_000, 3)) @ sd.T
    seen = se2.between(turned.measured, se2.inverse(se2.compose(told.measured, errors)))
    np.testing.assert_allclose(np.cov(seen.T), 1e-8 * turned.covariance, atol=2e-2 * 1e-8 * np.trace(turned.covariance))
    np.testing.assert_allclose(se2.rotation(0.7) @ turned.weak, told.weak, atol=1e-12)
    again = turned.inverse()
    np.testing.assert_allclose(again.covariance, told.covariance, atol=1e-12)
    np.testing.assert_allclose(again.measured, told.measured, atol=1e-12)
