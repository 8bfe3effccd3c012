"""What one robot's views say of another's walls."""

import numpy as np

from mapweave.core import se2
from mapweave.kernels.walls.sight import judge_walls
from mapweave.mapping.map_overlap import (
    LOOKS,
    SAME_WALL,
    SAME_WALL_SHARE,
    SIDED,
    VIEW_REACH,
    VIEW_THROUGH,
    KeyframeMap,
    drawn_twice,
    seen_alike,
    wall_overlap,
)
from mapweave.mapping.merge import merge_maps

from ..laser.test_merge import office_pair


def test_only_points_amid_free_floor_speak_against_clear_sight():
    """A map moved by half a metre contradicts itself close to its walls; moved by a room it does so amid the floor."""
    made = office_pair(7, 0.9)
    near = seen_alike(made.a, made.b, se2.compose(np.array([0.45, 0.0, 0.0]), made.transform))
    far = seen_alike(made.a, made.b, se2.compose(np.array([1.7, 1.1, 0.4]), made.transform))
    true = seen_alike(made.a, made.b, made.transform)
    assert true.clear > 0.98
    assert near.clear > near.share
    assert far.clear < 0.95


def test_a_map_without_walls_is_refused_from_either_side():
    made = office_pair(7, 0.5)
    empty = KeyframeMap("empty", np.zeros((2, 3)), [np.zeros((0, 2))] * 2)
    assert not merge_maps(made.b, empty).merged
    assert not merge_maps(empty, made.b).merged


def test_of_a_wall_and_half_of_it_all_of_the_half_overlaps_whichever_map_holds_it():
    wall = np.column_stack([np.arange(0.0, 8.0, 0.2), np.full(40, 2.0)])
    for held, other in ((wall, wall[:20]), (wall[:20], wall)):
        assert wall_overlap(other, KeyframeMap("one", np.zeros((1, 3)), [held]), np.zeros(3)) == 1.0


def test_a_wall_is_seen_or_seen_through_as_each_view_has_it():
    """The kernel beside the same said view by view, of maps that lie a little wrong."""
    made = office_pair(11, 0.8)
    T = se2.compose(made.transform, np.array([0.3, -0.2, 0.05]))
    walls, side = se2.act(T, made.b.walls), made.b.walls_side @ se2.rotation(float(T[2])).T
    a, rows = made.a, np.arange(0, len(made.a.pose), 7)
    args = LOOKS, np.array([0.5, 0.9])
    bands = judge_walls(a.pose[rows], a.views[rows], walls, side, (side != 0.0).any(axis=1), *args)
    seen, gone, deep = (band.sum(axis=1) for band in bands)
    assert 0 < deep.sum() < gone.sum()
    assert (bands[2] <= bands[1]).all()
    seen_banded = np.zeros_like(bands[0])
    bins = a.views.shape[1]
    seen_here, gone_here, behind = np.zeros(len(walls)), np.zeros(len(walls)), np.zeros(len(walls))
    for k in rows.tolist():
        x, y = se2.act(se2.inverse(a.pose[k]), walls).T
        r, at = np.hypot(x, y), np.floor(np.arctan2(y, x) / (2 * np.pi) * bins).astype(int)
        around = a.views[k][(at + np.array([[-1], [0], [1]])) % bins]
        known = np.isfinite(around).all(axis=0) & (r <= VIEW_REACH)
        like = known & (np.abs(around - r) < SAME_WALL + SAME_WALL_SHARE * r).any(axis=0)
        facing = ((a.pose[k, :2] - walls) * side).sum(axis=1) > -SIDED * r
        seen_here, behind = seen_here + (like & facing), behind + (like & ~facing)
        gone_here += known & ~like & (around.min(axis=0) - r > VIEW_THROUGH)
        cosine = np.abs(((a.pose[k, :2] - walls) * side).sum(axis=1)) / r
        np.add.at(seen_banded, (np.arange(len(walls)), (cosine >= 0.5).astype(int) + (cosine >= 0.9)), like & facing)
    assert min(seen_here.sum(), gone_here.sum(), behind.sum()) > 0
    assert np.abs(seen - seen_here).sum() <= 2  # a direction on the border of two bins may fall to either
    assert np.abs(gone - gone_here).sum() <= 2
    assert np.abs(bands[0] - seen_banded).sum() <= 4
    assert (bands[0].sum(axis=0) > 0).all()


def test_two_robots_of_which_one_map_is_bent_are_told_and_those_of_right_maps_are_not():
    """As of a robot whose way into the next room is wrong by ten degrees: the map drew that room's walls twice."""
    made = office_pair(7, 0.9)
    placed = se2.compose(made.transform, made.b.pose)
    half = len(placed) // 2
    turned = se2.compose(placed[half], np.array([0.0, 0.0, np.radians(10.0)]))
    bent = np.concatenate([placed[:half], se2.compose(turned, se2.between(placed[half], placed[half:]))])
    right, wrong = (KeyframeMap("2", pose, made.b.points) for pose in (placed, bent))
    one = KeyframeMap("1", made.a.pose, made.a.points)
    assert list(drawn_twice([one, right])) == []
    (found,) = drawn_twice([one, wrong])
    assert (found.code, found.robot, found.value["other"]) == ("walls-twice", "2", "robot1")
    assert found.value["value"] > 5.0


def room_seen(gone: float) -> KeyframeMap:
    """A room whose wall has, from the eighth view of twenty on, a gap as wide as `gone` [m], another wall behind it."""
    angle = np.radians(np.arange(-60.0, 60.0, 1.0))
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    pose, points = [], []
    for k in range(20):
        x = 0.05 * k
        hit = ray * ((3.0 - x) / ray[:, :1])
        behind = ray * ((5.0 - x) / ray[:, :1])
        open_there = (np.abs(hit[:, 1]) < 0.5 * gone) & (k >= 8)
        pose.append([x, 0.0, 0.0])
        points.append(np.where(open_there[:, None], behind, hit))
    return KeyframeMap("1", np.array(pose), points)


def test_walls_seen_through_are_as_wide_as_walls_and_a_map_knows_what_it_contradicts_of_itself():
    still, door, bent = (room_seen(wide) for wide in (0.0, 0.9, 3.0))
    assert (still.through, still.own) == (0.0, 0.0)
    assert door.through == 0.0
    assert bent.through > 0.1
    assert 0.0 < door.own < bent.own


def test_legs_of_tables_that_some_views_show_are_no_walls():
    """Thin things in rows and columns, each view shows some and goes through others; behind them stands a wall."""
    rng = np.random.default_rng(3)
    legs = np.stack(np.meshgrid(np.arange(2.0, 4.0, 0.4), np.arange(-1.0, 1.2, 0.4)), axis=-1).reshape(-1, 2)
    angle = np.radians(np.arange(-60.0, 60.0, 1.0))
    pose, points = [], []
    for k in range(30):
        at = np.array([0.05 * k, 0.0])
        r = 6.0 / np.cos(angle) - at[0]
        away = legs - at
        for leg in np.flatnonzero(rng.random(len(legs)) < 0.5):
            far, turn = np.hypot(*away[leg]), np.arctan2(away[leg, 1], away[leg, 0])
            hit = np.abs(angle - turn) < np.radians(0.6)
            r[hit] = np.minimum(r[hit], far)
        pose.append([*at, 0.0])
        points.append(np.column_stack([r * np.cos(angle), r * np.sin(angle)]))
    made = KeyframeMap("1", np.array(pose), points)
    assert made.own > 0.02
    assert made.through < 0.015


def test_contradictions_as_wide_as_a_door_leave_a_place_walled():
    still, door, bent = (room_seen(wide) for wide in (0.0, 0.9, 3.0))
    door, bent = (KeyframeMap("2", m.pose[10:], m.points[10:]) for m in (door, bent))
    narrow, wide = (seen_alike(still, m, np.zeros(3)) for m in (door, bent))
    assert narrow.walled == 1.0 > narrow.share
    assert wide.walled < 0.95
    assert wide.clear <= wide.walled
