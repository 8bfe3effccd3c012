"""Two robots' maps made one or refused: small worlds whose answer is known."""

import numpy as np
import pytest
from laser_pairs import PairConfig, drive_pair
from merge_trials import judged, office, symmetric

from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.core.walls import Walls
from mapweave.mapping.map_overlap import KeyframeMap, SeenAlike, lit_alike, seen_alike, wall_overlap
from mapweave.mapping.merge import merge_maps
from mapweave.mapping.merge_ambiguity import Pair, allowed
from mapweave.mapping.merge_search import Candidate, Start, whole_place
from mapweave.sim.laser_worlds import office_floor

SMALL = PairConfig(keyframes=130, beams=120)


def office_pair(seed, share, cfg=SMALL):
    floor = office_floor(600.0, seed)
    walls = Walls.of(floor.world.segments)
    return drive_pair(walls, floor.lower + 4.0, floor.upper - 4.0, share, np.random.default_rng([seed, 3]), cfg)


def box(x0, y0, x1, y1):
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


@pytest.fixture(scope="module")
def pair():
    return office_pair(3, 0.8)


@pytest.fixture(scope="module")
def merge(pair):
    return merge_maps(pair.a, pair.b)


def test_maps_with_unknown_starts_are_merged_where_they_belong(pair, merge):
    assert merge.merged, merge.reason
    error = se2.between(merge.transform, pair.transform)
    assert np.hypot(*error[:2]) < 0.2
    assert abs(error[2]) < 0.03
    assert error @ np.linalg.solve(merge.covariance, error) < 60.0
    assert "merged on" in merge.reason
    assert merge.overlap > 0.4
    assert merge.agreeing == sum(c.accepted for c in merge.closures)
    for c in merge.closures:
        if c.accepted:
            seen = se2.compose(pair.a.pose[c.first], c.measured)
            there = se2.compose(merge.transform, pair.b.pose[c.second])
            assert np.hypot(*(seen - there)[:2]) < 0.6
        else:
            assert c.reason
            assert not c.reason.startswith("it confirms")


def test_maps_that_share_little_are_merged_on_the_whole_of_what_they_share():
    made = office_pair(6, 0.05)
    told = merge_maps(made.a, made.b)
    assert told.merged, told.reason
    error = se2.between(told.transform, made.transform)
    assert np.hypot(*error[:2]) < 0.5
    assert abs(error[2]) < 0.05
    held = [c for c in told.closures if c.accepted]
    assert len(held) == told.agreeing == 1
    assert held[0].reason.startswith("it confirms the transform")
    assert "the whole maps" in told.reason
    assert np.linalg.eigvalsh(told.covariance).min() > 0


def test_the_row_for_the_metrics_has_every_key(merge):
    row = merge.row()
    for key in ("a", "b", "overlap", "score", "second", "agreeing", "chi2", "decision", "reason"):
        assert row[key] is not None, key
    assert (row["a"], row["b"], row["decision"]) == ("robot1", "robot2", "merged")


def test_the_other_order_gives_the_inverse(pair, merge):
    back = merge_maps(pair.b, pair.a)
    assert back.merged
    assert (back.a, back.b) == ("robot2", "robot1")
    both = se2.compose(merge.transform, back.transform)
    assert np.abs(both).max() < (0.15 if len(pair.a.pose) == len(pair.b.pose) else 1e-9)
    c = next(c for c in back.closures if c.accepted)
    seen = se2.compose(pair.b.pose[c.first], c.measured)
    assert np.hypot(*(seen - se2.compose(back.transform, pair.a.pose[c.second]))[:2]) < 0.6


@pytest.mark.slow
def test_a_start_that_is_wrong_is_overruled_by_the_scans(pair, merge):
    false = Start(se2.compose(merge.transform, np.array([9.0, 4.0, 1.2])), np.array([0.5, 0.5, 0.1]))
    told = merge_maps(pair.a, pair.b, start=false)
    if told.merged:
        assert np.abs(se2.between(told.transform, merge.transform))[:2].max() < 0.2
        assert "the scans overrule the start that was given" in told.reason
    else:
        assert "near the start that was given" in told.reason
    near = Start(se2.compose(pair.transform, np.array([0.4, -0.3, 0.05])), np.array([0.5, 0.5, 0.1]))
    told = merge_maps(pair.a, pair.b, start=near)
    assert told.merged
    assert "overrule" not in told.reason
    assert np.abs(se2.between(told.transform, pair.transform))[:2].max() < 0.2


def test_different_buildings_are_refused_with_the_reason(pair):
    other = office_pair(21, 0.5)
    told = merge_maps(pair.a, other.b)
    assert not told.merged
    assert told.transform is None
    assert "overlap" in told.reason or "fit equally well" in told.reason


def test_in_a_flush_corridor_the_direction_that_is_not_held_is_named():
    walls = Walls.of(np.array(box(-25.0, 0.0, 85.0, 2.5)))
    rng = np.random.default_rng(8)
    made = drive_pair(walls, np.zeros(2), np.array([60.0, 2.5]), 0.5, rng, PairConfig(keyframes=100, beams=120))
    told = merge_maps(made.a, made.b)
    assert not told.merged
    assert "a corridor" in told.reason
    assert "is not held" in told.reason
    angle = float(told.reason.split("direction of ")[1].split(" ")[0])
    frame = made.a if "the map of robot1" in told.reason else made.b
    way = np.linalg.svd(frame.pose[:, :2] - frame.pose[:, :2].mean(axis=0))[2][0]
    apart = abs(angle - np.degrees(np.arctan2(way[1], way[0])) % 180.0)
    assert min(apart, 180.0 - apart) < 5.0


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_a_building_that_looks_the_same_turned_round_is_refused_with_both_places(share):
    """Also when each robot saw another half: the far ends of the corridor, which both saw, allow the other place."""
    rng = np.random.default_rng(4)
    parts = [[-12.0, 4.0, 0.0, 4.0], [-12.0, -4.0, 0.0, -4.0], [-12.0, -4.0, -12.0, 4.0]]
    parts += [
        [-8.0, 1.0, -8.0, 4.0],
        [-5.0, -4.0, -5.0, 0.5],
        *box(-10.5, -2.5, -9.5, -1.5),
        *box(-3.0, 2.4, -1.8, 3.2),
    ]
    half = np.array(parts)
    walls = Walls.of(np.concatenate([half, -half]))
    made = drive_pair(walls, np.array([-12.0, -4.0]), np.array([12.0, 4.0]), share, rng, SMALL)
    told = merge_maps(made.a, made.b)
    assert not told.merged
    assert "fit equally well" in told.reason
    assert told.rival is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "seed", "verdict"),
    [(office, 700037, "right"), (office, 700079, "right"), (symmetric, 930023, "refused")],
)
def test_another_place_is_in_question_unless_walls_stand_amid_free_floor_there(made, seed, verdict):
    """Offices whose rooms lie alike turned round, told by what was seen through; the same building turned, bent."""
    rng = np.random.default_rng([seed, 17])
    pair = made(rng, float(rng.uniform(0.0, 0.8)))
    told = merge_maps(pair.a, pair.b)
    assert judged(pair, told.transform) == verdict, told.reason
    assert told.rival is not None
    assert ("fit equally well" in told.reason) is (verdict == "refused")


@pytest.fixture(scope="module")
def small_office():
    """Two robots that saw all of a building that looks nearly the same turned round, whose desks alone differ."""
    rng = np.random.default_rng(11)
    half = [[-10.0, 4.0, 0.0, 4.0], [-10.0, -4.0, 0.0, -4.0], [-10.0, -4.0, -10.0, 4.0]]
    half += [[-5.0, 1.0, -5.0, 4.0], [-5.0, -4.0, -5.0, -1.0]]
    parts = np.concatenate([np.array(half), -np.array(half), np.array(box(-8.0, 3.2, -6.6, 4.0))])
    return drive_pair(Walls.of(parts), np.array([-10.0, -4.0]), np.array([10.0, 4.0]), 1.0, rng, SMALL)


@pytest.mark.parametrize(
    ("best", "other", "so"),
    [
        (0.81, 0.81, True),
        (0.96, 0.86, True),
        (1.0, 0.91, True),  # a tenth contradicted may be people and doors
        (0.97, 0.83, False),
        (0.98, 0.88, False),
        (0.80, 0.79, False),
    ],
)
def test_a_place_five_times_as_much_contradicted_as_the_best_is_no_rival(small_office, best, other, so):
    pair = Pair(small_office.a, small_office.b, whole_place(small_office.a, featured=False), 0.9)
    seen = [SeenAlike(round(1000 * share), round(1000 * (1.0 - share)), 1.0, 1.0) for share in (other, best)]
    assert allowed(pair, *(Candidate(np.zeros(3), np.eye(3), 0.0, (), s) for s in seen)) is so


@pytest.mark.slow
@pytest.mark.parametrize("off", [(0.3, -0.3, 0.05), (-0.7, 0.4, -0.1)])
def test_of_two_places_that_fit_alike_a_start_decides(small_office, off):
    made = small_office
    assert "fit equally well" in merge_maps(made.a, made.b).reason
    start = Start(se2.compose(made.transform, np.array(off)), np.array([0.5, 0.5, 0.1]))
    told = merge_maps(made.a, made.b, start=start)
    assert told.merged, told.reason
    assert np.hypot(*se2.between(told.transform, made.transform)[:2]) < 0.2
    back = merge_maps(made.b, made.a, start=Start(se2.inverse(start.transform), start.sd))
    assert back.merged, back.reason


def middle_of(m):
    """[m] of the building, in the frame of a map that holds all of it."""
    return 0.5 * (m.walls.min(axis=0) + m.walls.max(axis=0))


def shining(m, frame, even=False):
    """The map with walls whose brightness is told by where they stand in `frame`."""
    at = [se2.act(frame, se2.act(p, c)) for p, c in zip(m.pose, m.points, strict=True)]
    rng = np.random.default_rng(1)
    levels = [np.floor(0.7 * c).astype(int) @ np.array([7, 13]) % 5 / 5.0 * (not even) for c in at]
    return KeyframeMap(m.robot, m.pose, m.points, [v + rng.normal(0.0, 0.02, len(v)) for v in levels])


def test_of_two_places_that_fit_alike_the_brightness_of_the_walls_decides(small_office):
    a, b = shining(small_office.a, np.zeros(3)), shining(small_office.b, small_office.transform)
    true = small_office.transform
    assert lit_alike(a, b, true) > 0.8
    turned = se2.compose(np.array([*(2.0 * middle_of(small_office.a)), np.pi]), true)
    assert lit_alike(a, b, turned) < 0.4
    assert lit_alike(small_office.a, b, true) is None
    assert seen_alike(a, b, turned).share > 0.9
    assert lit_alike(shining(a, np.zeros(3), even=True), b, true) is None
    assert lit_alike(a, b, np.array([500.0, 0.0, 0.0])) is None
    told = merge_maps(a, b)
    assert told.merged, told.reason
    assert np.hypot(*se2.between(told.transform, true)[:2]) < 0.2
    assert "at other places their walls do not shine alike" in told.reason
    even = merge_maps(shining(a, np.zeros(3), even=True), shining(b, np.zeros(3), even=True))
    assert "fit equally well" in even.reason


def test_a_start_where_the_scans_do_not_fit_decides_nothing(small_office):
    made = small_office
    false = Start(se2.compose(made.transform, np.array([2.5, 1.5, 0.8])), np.array([0.3, 0.3, 0.1]))
    told = merge_maps(made.a, made.b, start=false)
    assert not told.merged
    assert "near the start that was given: no place fits there as well as elsewhere" in told.reason
    assert "everywhere: two places" in told.reason


def test_a_start_is_never_less_likely_than_that_it_is_false():
    start = Start(np.array([1.0, 2.0, 0.5]), np.array([0.5, 0.5, 0.1]))
    assert start.likelihood(start.transform) == 1.0
    assert start.likelihood(np.array([50.0, 2.0, 0.5])) == pytest.approx(0.05)
    off = start.likelihood(se2.compose(start.transform, np.array([np.hypot(0.5, 0.3), 0.0, 0.0])))
    assert off == pytest.approx(0.05 + 0.95 * np.exp(-0.5))
    assert start.near(np.array([2.5, 2.0, 0.6]))
    assert not start.near(np.array([2.5, 2.0, 0.9]))


def test_what_one_saw_through_speaks_against_a_transform(pair):
    true = seen_alike(pair.a, pair.b, pair.transform)
    assert true.share > 0.95
    assert true.alike > 150
    shifted = seen_alike(pair.a, pair.b, se2.compose(np.array([1.5, 1.0, 0.3]), pair.transform))
    assert shifted.share < 0.85
    far = seen_alike(pair.a, pair.b, np.array([500.0, 0.0, 0.0]))
    assert (far.alike, far.through, far.share) == (0, 0, 0.0)
    walls = np.concatenate([se2.act(p, c) for p, c in zip(pair.a.pose, pair.a.points, strict=True)])
    assert wall_overlap(walls, pair.b, pair.transform) > 0.5
    assert wall_overlap(walls, pair.b, np.array([500.0, 0.0, 0.0])) == 0.0


def test_a_wall_seen_from_its_two_sides_does_not_speak_for_a_place():
    rng = np.random.default_rng(2)
    walls = Walls.of(np.array(box(0.0, 0.0, 14.0, 7.0)))
    made = drive_pair(walls, np.zeros(2), np.array([14.0, 7.0]), 1.0, rng, PairConfig(keyframes=60, beams=120))
    true = seen_alike(made.a, made.b, made.transform)
    assert true.alike > 150
    lengths = np.hypot(*made.a.walls_side.T)
    assert np.mean(np.abs(lengths - 1.0) < 1e-9) > 0.8
    assert np.mean(((middle_of(made.a) - made.a.walls) * made.a.walls_side).sum(axis=1) > 0) > 0.8
    normals = made.a.walls_side[lengths > 0.5]
    square = np.angle(np.mean(np.exp(4j * np.arctan2(normals[:, 1], normals[:, 0])))) / 4.0
    for axis in (0, 1):  # the room beside, which shares a wall
        across = np.array([np.cos(square + axis * np.pi / 2), np.sin(square + axis * np.pi / 2)])
        shift = np.array([*(np.ptp(made.a.walls @ across) * across), 0.0])
        assert seen_alike(made.a, made.b, se2.compose(shift, made.transform)).alike < 30


def test_maps_that_hold_nothing_are_told():
    with pytest.raises(DataError, match="0 keyframes"):
        KeyframeMap("robot1", np.zeros((0, 3)), [])
    empty = KeyframeMap("robot1", np.zeros((2, 3)), [np.zeros((0, 2))] * 2)
    with pytest.raises(DataError, match="found none"):
        merge_maps(empty, empty)
    lonely = KeyframeMap("robot2", np.zeros((1, 3)), [np.random.default_rng(0).normal(0, 3, (200, 2))])
    assert not merge_maps(lonely, lonely).merged


@pytest.mark.slow
def test_along_a_flush_corridor_a_start_alone_holds_the_maps_and_no_better_than_it_says():
    walls = Walls.of(np.array(box(-25.0, 0.0, 65.0, 2.5)))
    cfg = PairConfig(keyframes=70, beams=120)
    made = drive_pair(walls, np.array([0.0, 0.0]), np.array([40.0, 2.5]), 0.7, np.random.default_rng(61), cfg)
    assert merge_maps(made.a, made.b).reason.startswith("a corridor")
    off = np.array([0.2, -0.15, 0.02])
    sd = np.array([0.2, 0.2, 0.03])
    start = Start(se2.compose(made.transform, off), sd)
    for m, told, true, said in (
        (made.a, merge_maps(made.a, made.b, start=start), made.transform, start.transform),
        (
            made.b,
            merge_maps(made.b, made.a, start=Start(se2.inverse(start.transform), sd)),
            se2.inverse(made.transform),
            se2.inverse(start.transform),
        ),
    ):
        assert told.merged, told.reason
        assert "a corridor" in told.reason
        e = se2.between(true, told.transform)
        assert e @ np.linalg.solve(told.covariance, e) < 11.34  # 99 % of 3 degrees of freedom
        along = np.linalg.svd(m.pose[:, :2] - m.pose[:, :2].mean(axis=0))[2][0]
        assert abs(along @ (told.transform - said)[:2]) < 0.1
        own = se2.rotation(told.transform[2]).T @ along
        assert np.sqrt(own @ told.covariance[:2, :2] @ own) >= 0.2
        assert np.sqrt(np.linalg.inv(told.closures[0].information)[:2, :2].trace()) >= 0.2
    vague = merge_maps(made.a, made.b, start=Start(start.transform, np.array([2.0, 2.0, 0.1])))
    assert not vague.merged
    assert "a corridor" in vague.reason


@pytest.mark.slow
def test_a_start_holds_a_short_map_to_a_longer_one_as_well_and_says_why_where_it_does_not():
    """Seen from the longer map's robot, what a start says of its heading would leave metres open far away."""
    walls = Walls.of(np.array(box(-25.0, 0.0, 65.0, 2.5)))
    cfg = PairConfig(keyframes=70, beams=120)
    made = drive_pair(walls, np.array([0.0, 0.0]), np.array([40.0, 2.5]), 0.7, np.random.default_rng(69), cfg)
    assert len(made.b.pose) > len(made.a.pose)
    sd = np.array([0.5, 0.5, 0.1])
    told = merge_maps(made.a, made.b, start=Start(se2.compose(made.transform, np.array([0.2, 0.3, 0.2])), sd))
    assert told.merged, told.reason
    e = se2.between(made.transform, told.transform)
    assert e @ np.linalg.solve(told.covariance, e) < 11.34  # 99 % of 3 degrees of freedom
    elsewhere = se2.compose(made.transform, np.array([0.0, 30.0, 0.0]))
    told = merge_maps(made.a, made.b, start=Start(elsewhere, sd))
    assert not told.merged
    assert "the start alone does not hold them: " in told.reason
