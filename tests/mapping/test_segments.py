"""Where a trajectory is not one piece."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.findings import Finding
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Scan, Track
from mapweave.laser.closures import Closure
from mapweave.laser.keyframes import KeyframeConfig, KeyframeMaker
from mapweave.laser.log_warnings import wheels_leap
from mapweave.laser.robot_graph import RobotGraph
from mapweave.laser.scan_odometry import ScanInfo
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.graph_slam import GONE, SegmentBorder, segment_keyframe
from mapweave.mapping.laser_mapping import map_laser
from mapweave.mapping.segments import (
    FADED,
    GAP,
    JUMP,
    LEARNED,
    LOOSE,
    REFUSED,
    SLIP,
    SPRANG,
    Borders,
    _Learned,
    border_covariance,
    bridged,
    cuts_disputed,
    held_over,
    pieces_of,
    segment_findings,
    set_down,
    still_apart,
    way_bent,
    way_loose,
)
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

STEP = np.array([0.3, 0.0, 0.1])


def info(innovation=(0.0, 0.0, 0.0), share=0.9, decision="matched"):
    return ScanInfo(np.array(innovation), 100, int(100 * share), decision)


def after(told, step=STEP, apart=0.2, *, wheels=True):
    """What is said of a scan that comes after many that were sure."""
    borders = Borders()
    for k in range(LEARNED + 5):
        assert borders.seen(0.2 * k, info(decision="first" if k == 0 else "matched"), STEP, wheels=wheels) == ""
    return borders.seen(0.2 * (LEARNED + 4) + apart, told, step, wheels=wheels)


@pytest.mark.parametrize(
    ("told", "why"),
    [
        (info(), ""),
        (info((0.9, 0.0, 0.0)), ""),  # most returns match: wheels slipped
        (info((0.3, 0.0, 0.0), share=0.49), FADED),
        (info((0.0, 0.0, -0.3), share=0.4), FADED),
        (info((0.3, 0.0, 0.0), share=0.1), SLIP),  # all at once
        (info((0.0, 0.0, -0.3), share=0.05), SLIP),
        (info((0.1, 0.0, 0.1), share=0.4), ""),  # few match, but where wheels put them
        (info((0.0, 1.2, 0.0)), JUMP),
        (info((0.0, 0.0, 1.2)), JUMP),
        (info(share=0.2, decision="odometry"), FADED),
        (info(share=0.1, decision="odometry"), REFUSED),
        (info(decision="empty"), ""),
    ],
)
def test_a_step_is_sure_unless_matches_and_wheels_leave_it_open(told, why):
    assert after(told) == why


def test_wheels_lead_on_where_views_fade_and_not_where_they_were_contradicted():
    borders = Borders()
    for k in range(LEARNED + 5):
        borders.seen(0.2 * k, info(decision="first" if k == 0 else "matched"), STEP, wheels=True)
    later = 0.2 * (LEARNED + 5)
    faded = [info(share=share, decision="odometry") for share in (0.2, 0.1, 0.0)]
    assert [borders.seen(later + 0.2 * k, told, STEP, wheels=True) for k, told in enumerate(faded)] == [FADED] * 3
    assert borders.seen(later + 0.6, info((0.0, 1.2, 0.0), share=0.6), STEP, wheels=True) == JUMP
    assert borders.seen(later + 0.8, faded[0], STEP, wheels=True) == REFUSED
    assert borders.seen(later + 1.0, faded[1], STEP, wheels=True) == REFUSED
    assert borders.seen(later + 1.2, info(share=0.6), STEP, wheels=True) == ""
    assert borders.seen(later + 1.4, faded[1], STEP, wheels=True) == FADED


def test_a_view_fades_the_sooner_the_farther_the_robot_drove_and_a_narrow_one_as_it_turns():
    assert after(info(share=0.1, decision="odometry"), np.array([0.5, 0.0, 0.0])) == FADED
    assert after(info(share=0.1, decision="odometry"), np.array([0.0, 0.0, 0.5])) == REFUSED
    borders = Borders()
    for k in range(LEARNED + 5):
        borders.seen(0.2 * k, info(decision="first" if k == 0 else "matched"), STEP, wheels=True)
    turned = info(share=0.0, decision="odometry")
    assert borders.seen(0.2 * (LEARNED + 5), turned, np.array([0.0, 0.0, 0.5]), wheels=True, wide=1.0) == FADED


def test_wheels_that_tell_more_than_robots_move_between_two_scans_do_not_lead_on():
    faded = info(share=0.4, decision="odometry")
    assert after(faded, np.array([0.45, 0.0, 0.4])) == FADED
    assert after(faded, np.array([1.0, 0.0, 0.1])) == after(faded, np.array([0.3, 0.0, 1.1])) == REFUSED


def test_over_a_border_where_wheels_lead_on_they_are_known_to_err_the_less_the_less_they_tell():
    near, far = (np.sqrt(np.diag(border_covariance(np.array([x, 0.0, 0.5 * x]), FADED))) for x in (0.2, 2.0))
    assert (near < far).all()
    assert (far < np.sqrt(np.diag(border_covariance(np.array([2.0, 0.0, 1.0]))))).all()


@pytest.mark.parametrize(("scans", "slid"), [(-0.2, True), (0.0, True), (0.19, False)])
def test_the_keyframe_after_views_that_faded_lies_where_wheels_say_since_the_last_one_if_scans_slid_before(scans, slid):
    maker, wheels, seen = (
        KeyframeMaker(0, KeyframeConfig(distance=1.0)),
        np.array([0.2, 0, 0.1]),
        np.array([scans, 0, 0]),
    )
    maker.keyframe(0.0, GONE)
    pose = np.zeros(3)
    for k in range(1, 4):
        maker.advance(pose := np.asarray(se2.compose(pose, seen)), seen, np.eye(3), wheels)
        if k < 3:
            assert maker.keyframe(float(k), GONE) is None
    cut = SegmentBorder(FADED, border_covariance(wheels, FADED), se2.between(wheels, seen))
    made = segment_keyframe(maker, 3.0, GONE, cut)
    way = se2.compose(se2.compose(wheels if slid else seen, wheels if slid else seen), wheels)
    np.testing.assert_allclose(made.step, way, atol=1e-12)
    assert np.array_equal(made.step, made.wheels) == slid
    assert made.border == FADED


def test_without_wheels_no_match_contradicts_them():
    assert after(info((2.0, 0.0, 0.0), share=0.4), wheels=False) == ""
    assert after(info(decision="odometry"), wheels=False) == REFUSED


def alone(moves, apart=0.2):
    """At which of the steps [m] along x, told by scans alone, the robot sprang."""
    borders = Borders()
    borders.seen(0.0, info(decision="first"), np.zeros(3), wheels=False)
    steps = [borders.seen(apart * (k + 1), info(), np.array([x, 0.0, 0.0]), wheels=False) for k, x in enumerate(moves)]
    assert set(steps) <= {"", SPRANG}
    return [k for k, why in enumerate(steps) if why]


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.25])
def test_scans_alone_that_tell_another_speed_at_once_slipped(speed):
    assert alone([*[speed] * 10, speed + 1.0, *[speed] * 10]) == [10]
    assert alone([*[speed] * 10, speed - 1.0, *[speed] * 10]) == [10]
    assert alone([*[speed] * 10, *[speed + 1.0] * 10]) == [10]  # and a robot that goes on so is not cut again


def test_robots_come_to_a_speed_and_stand_from_scan_to_scan():
    assert alone([0.0, 0.2, 0.4, 0.6, 0.8, 0.8, 0.5, 0.2, 0.0]) == []
    assert alone([0.0, 1.0, 2.0, 1.0, 0.0], apart=0.5) == []


def test_after_a_pause_a_robot_that_moved_may_be_anywhere():
    assert after(info(), 3.0 * STEP, apart=60.0) == GAP
    assert after(info(), wheels=False, apart=60.0) == GAP
    assert after(info(), np.array([0.05, 0.0, 0.01]), apart=60.0) == ""
    assert after(info(), apart=4.0) == ""


def test_a_pause_hid_nothing_where_a_robot_went_on_as_ever_and_scans_are_where_wheels_say():
    assert after(info(), apart=60.0) == ""
    assert after(info((0.3, 0.0, 0.0)), apart=60.0) == GAP
    assert after(info((0.0, 0.0, 0.25)), apart=60.0) == GAP
    assert after(info(share=0.4), apart=60.0) == GAP


def leaps(moves):
    """Whether wheels that drive so far along x from scan to scan [m], a second apart, were set anew, at each."""
    borders, x, told = Borders(), 0.0, []
    for k, move in enumerate(moves):
        x += move
        told.append(borders.leapt(float(k), np.array([x, 0.0, 0.0])))
        borders.seen(float(k), info(decision="first" if k == 0 else "matched"), np.array([move, 0.0, 0.0]), wheels=True)
    return told


def test_wheels_that_are_set_anew_leap_once_and_a_robot_that_drives_off_does_not_leap_for_ever():
    still = [0.0] * (2 * LEARNED)
    assert sum(leaps([*still, 40.0, *still])) == 1
    assert 1 <= sum(leaps([*still, *[2.0] * 30])) <= 4


@pytest.mark.parametrize(
    ("before", "after", "anew"),
    [
        ((5.0, 1.0, 0.0), (5.02, 1.0, 3.1), False),  # it turned about
        ((0.1, 0.3, 2.5), (0.05, 0.0, 0.02), True),  # set to zero, near where it began
        ((5.0, 1.0, 0.0), (0.05, 0.0, 0.02), True),
        ((5.0, 1.0, 0.0), (7.0, 9.0, 3.1), True),
    ],
)
def test_wheels_that_turn_and_do_not_move_are_those_of_a_robot_that_turned_about(before, after, anew):
    borders, poses = Borders(), [before] * (2 * LEARNED) + [after] * 3
    told = []
    for k, pose in enumerate(poses):
        told.append(borders.leapt(float(k), np.array(pose)))
        borders.seen(float(k), info(decision="first" if k == 0 else "matched"), np.zeros(3), wheels=True)
    assert any(told) == anew
    scans = [Scan(np.ones(1), np.ones(1, bool), None, 0.0, 0.1, 5.0, odometry=np.array(pose)) for pose in poses]
    assert bool(wheels_leap(np.arange(float(len(poses))), scans, "1", segments=True)) == anew


def test_that_a_robot_drives_fast_is_known_from_its_first_step():
    assert not any(leaps([*[2.0] * 8, *[0.0] * (LEARNED + 5), 2.0]))


@pytest.mark.parametrize("quantile", [0.5, 0.95, 0.98])
def test_what_is_usual_is_the_quantile_of_the_first_rows(quantile):
    rows = np.random.default_rng(3).exponential(size=(10 * LEARNED + 5, 2))
    learned = _Learned(2, quantile)
    assert learned.usual.tolist() == [0.0, 0.0]
    for k, row in enumerate(rows, 1):
        learned.see(row.tolist())
        first = rows[: min(k, 10 * LEARNED)]
        assert len(learned) == len(first)
        np.testing.assert_allclose(learned.usual, np.quantile(first, quantile, axis=0), rtol=1e-12)


def test_over_a_border_a_long_step_may_err_by_more():
    assert np.allclose(np.sqrt(np.diag(border_covariance(np.zeros(3)))), [1.0, 1.0, 0.5])
    assert np.allclose(np.sqrt(np.diag(border_covariance(np.array([6.0, 0.0, 2.0])))), [3.0, 3.0, 1.0])


def straight(borders=(), closures=(), n=40, step=0.5):
    """The graph of a robot that drove along x. borders: keyframes; closures: pairs of keyframes that hold."""
    pose = np.column_stack([step * np.arange(n), np.zeros(n), np.zeros(n)])
    held = [
        Closure((0, 0), a, b, True, "", se2.between(pose[a], pose[b]), np.eye(3), np.zeros(3), 1.0, 0.0)
        for a, b in closures
    ]
    return RobotGraph(
        robot="1",
        t=np.arange(n, dtype=float),
        pose=pose,
        cov=np.zeros((n, 3, 3)),
        path=pose[:, 0],
        step=se2.between(pose[:-1], pose[1:]),
        step_information=np.tile(np.eye(3), (n - 1, 1, 1)),
        closures=tuple(held),
        start=np.zeros(n + 1, dtype=np.int64),
        points=np.zeros((0, 2)),
        normals=np.zeros((0, 2)),
        q=None,
        lined=np.zeros(0, dtype=bool),
        sensor=np.zeros((n, 2)),
        border=tuple("slip" if k in borders else "" for k in range(n)),
    )


@pytest.mark.parametrize(
    ("borders", "closures", "pieces"),
    [
        ((), (), [range(40)]),
        ((20,), (), [range(20), range(20, 40)]),
        ((20,), ((3, 30),), [range(40)]),
        ((10, 20), ((3, 30),), [[*range(10), *range(20, 40)], range(10, 20)]),
        ((20, 22), (), [range(22), range(22, 40)]),  # a short one goes with the one before it,
        ((3,), (), [range(40)]),  # or with the next
        ((3, 5), (), [range(40)]),
    ],
)
def test_a_trajectory_is_in_pieces_that_no_closure_joins(borders, closures, pieces):
    assert [p.tolist() for p in pieces_of(straight(borders, closures))] == [list(p) for p in pieces]


def test_what_a_border_parts_is_held_where_a_closure_reaches_over_it():
    assert not held_over(straight((20,)), 20.0)
    assert not held_over(straight(), 20.0)  # nothing but the step there
    assert held_over(straight((20,), ((3, 30),)), 20.0)
    assert held_over(straight(closures=((3, 30),)), 20.0)
    assert not held_over(straight(closures=((3, 10),)), 20.0)
    assert held_over(straight(), 0.0)
    assert held_over(straight(), 99.0)


def test_what_a_border_parts_is_held_where_closures_reach_most_of_what_came_after():
    assert held_over(straight((20, 22), ((3, 30),)), 20.0)  # but for a short way right after it
    assert not held_over(straight((20, 22), ((3, 21),)), 20.0)  # that alone
    assert not held_over(straight((20, 34), ((3, 38),)), 20.0)
    assert held_over(straight((20, 26), ((3, 38),)), 20.0)


def test_a_robot_that_was_set_down_sees_where_it_is_and_one_whose_views_fade_drove_on():
    assert set_down(straight((20,)), 20.0)
    assert set_down(straight((20, 22)), 20.0)  # a scan taken while it was set down is of neither place
    assert not set_down(straight((20, 21, 22)), 20.0)
    assert set_down(straight((20, 26, 27)), 20.0)
    assert not set_down(straight((20,), ((3, 30),)), 20.0)


def test_nothing_is_apart_from_a_way_too_short_to_find_again():
    assert "segment-apart" in {f.code for f in segment_findings(straight((20,)))}
    assert "segment-apart" not in {f.code for f in segment_findings(straight((3,)))}


def test_a_piece_that_another_robot_ties_is_no_longer_told_to_be_apart():
    graph = straight((20,))
    told = segment_findings(graph)
    assert [f.code for f in told] == ["track-patchy", "track-cut", "segment-apart"]
    assert still_apart(told, graph, ()) == told
    assert [f.code for f in still_apart(told, graph, (1,))] == ["track-patchy", "track-cut"]


def test_a_trajectory_is_patchy_from_a_cut_in_fifty_keyframes_on():
    assert "track-patchy" not in {f.code for f in segment_findings(straight((20,), n=60))}
    assert "track-patchy" in {f.code for f in segment_findings(straight((20, 30), n=60))}
    assert "track-patchy" not in {f.code for f in segment_findings(straight((10,), n=19))}


def test_wheels_that_were_set_anew_tell_no_motion_over_the_border():
    graph = straight((20,))
    track = Track(graph.t, graph.pose)
    dead = np.array(graph.pose) + np.array([1.0, 2.0, 0.0])
    dead[20:] = se2.compose(np.array([7.0, -3.0, 2.0]), se2.between(dead[20], dead[20:]))
    scans = tuple(Scan(np.ones(1), np.ones(1, bool), None, 0.0, 0.1, 5.0, odometry=p) for p in dead)
    log = LaserLog("1", "", graph.t, scans, Track(graph.t, dead, frame="odom"))
    mended, wheels = bridged(log, graph, track, Track(graph.t, dead, frame="odom"))
    steps = se2.between(wheels.pose[:-1], wheels.pose[1:])
    assert np.allclose(steps, graph.step)
    assert np.allclose([scan.odometry for scan in mended.scans], wheels.pose)
    assert np.allclose(wheels.pose[0], dead[0])


def bent(pull, borders=()):
    """A straight way whose keyframes from 10 to 40 lie `pull` [m] closer together in all than its steps tell."""
    graph = straight(borders, n=60)
    pose = np.array(graph.pose)
    pose[:, 0] -= pull * np.clip((np.arange(60) - 10) / 30, 0.0, 1.0)
    return replace(graph, pose=pose, step_information=np.tile(np.diag([1600.0, 1600.0, 4e4]), (59, 1, 1)))


def test_places_that_bend_a_way_beyond_what_its_steps_may_err_by_are_told_with_where():
    (told,) = way_bent(bent(2.8))
    assert (told.code, told.severity, told.robot) == ("way-bent", "doubtful", "1")
    assert told.span[0] <= 12.0
    assert told.span[1] >= 38.0
    assert told.value["value"] == pytest.approx(2.8, rel=0.1)
    assert told.value["sd"] == pytest.approx(2.8 / (0.025 * np.sqrt(30)), rel=0.15)
    assert told.value["way"] == pytest.approx(0.5 * (told.span[1] - told.span[0]))
    assert way_bent(bent(-2.8))


def test_a_way_bent_within_what_its_steps_may_err_by_or_over_a_border_is_not_told():
    assert way_bent(bent(0.4)) == ()
    assert way_bent(bent(0.65)) == ()  # 4.7 standard deviations
    leap = np.array(bent(0.0).pose)
    leap[20:, 0] -= 3.0
    assert way_bent(replace(bent(0.0, borders=(20,)), pose=leap)) == ()
    assert way_bent(replace(bent(0.0), pose=leap))
    assert way_bent(straight(n=4)) == ()


@pytest.mark.parametrize(("pull", "places", "told"), [(2.8, 20, False), (2.8, 18, True), (3.5, 20, True)])
def test_a_way_that_a_score_of_places_pull_by_metres_was_driven_by_a_robot_that_slid_and_is_mended(pull, places, told):
    over = [(k % 8, 50 + k % 9) for k in range(places)]
    within = [(12, 30), (15, 58)] * 10  # of one side of it alone, they tell nothing of all of it
    graph = replace(bent(pull), closures=straight(closures=[*over, *within], n=60).closures)
    assert bool(way_bent(graph)) == told


@pytest.mark.parametrize(("by", "told"), [(1.2, True), (0.8, False)])
def test_a_slide_that_places_contradict_and_that_was_laid_upon_one_step_is_told_with_when(by, told):
    graph = bent(0.0)
    pose = np.array(graph.pose)
    pose[30:, 0] -= by
    found = way_bent(replace(graph, pose=pose, border=tuple("contradicted" if k == 30 else "" for k in range(60))))
    assert [(f.code, f.severity, f.span) for f in found] == [("way-slid", "doubtful", (29.0, 30.0))] * told
    assert [f.value for f in found] == [pytest.approx(by)] * told
    assert way_bent(replace(graph, pose=pose, border=tuple("slip" if k == 30 else "" for k in range(60)))) == ()


def test_a_way_whose_covariances_say_that_it_may_be_off_by_metres_is_told_with_when():
    graph = straight(n=60)
    cov = np.tile(np.diag([1e-4, 1e-4, 1e-6]), (60, 1, 1))
    cov[30:50, :2, :2] = se2.rotation(0.7) @ np.diag([LOOSE**2 * 1.2, 0.01]) @ se2.rotation(0.7).T
    (told,) = way_loose(replace(graph, cov=cov))
    assert (told.code, told.severity, told.robot) == ("way-loose", "doubtful", "1")
    assert told.span == (graph.t[30], graph.t[49])
    assert told.value == pytest.approx(LOOSE * np.sqrt(1.2))
    cov[30:50] *= 0.8
    assert way_loose(replace(graph, cov=cov)) == ()


def test_a_way_that_may_be_off_by_less_but_nearly_everywhere_is_told_too():
    graph = straight(n=60)
    cov = np.tile(1e-4 * np.eye(3), (60, 1, 1))
    cov[10:, 0, 0] = (0.9 * LOOSE) ** 2  # over five sixths of the time
    (told,) = way_loose(replace(graph, cov=cov))
    assert told.span == (graph.t[10], graph.t[59])
    assert told.value == pytest.approx(0.9 * LOOSE)
    cov[10:50] = 1e-4 * np.eye(3)
    assert way_loose(replace(graph, cov=cov)) == ()


def test_a_piece_that_nothing_ties_to_the_start_is_not_told_to_be_loose():
    cov = np.tile(1e-4 * np.eye(3), (60, 1, 1))
    cov[56:] = 1e4 * np.eye(3)  # too short to be told as apart
    assert way_loose(replace(straight((56,), n=60), cov=cov)) == ()
    (told,) = way_loose(replace(straight((56,), ((10, 57),), n=60), cov=cov))
    assert told.span == (56.0, 59.0)


def test_a_bare_corridor_that_nothing_ties_is_not_called_good():
    """What the covariances say, the verdict says; where light ties it, it is good."""
    world = CorridorConfig(distance=150.0)
    log = simulate_corridor(world, seed=0).log
    made = map_laser(log, LaserConfig(method="graph", feature="none"), 0)
    assert "way-loose" in {found.code for found in made.findings}
    lit = map_laser(log, LaserConfig(method="graph"), 0)
    assert all(found.severity == "note" for found in lit.findings)


def test_places_far_from_where_wheels_lead_over_a_cut_are_told_unless_the_scene_changed_there_or_wheels_leapt():
    graph = straight((30,), n=60)
    t = float(graph.t[30])
    pose = np.array(graph.pose)
    pose[30:, 1] += 4.0
    moved = replace(graph, pose=pose)
    (told,) = cuts_disputed(moved, ())
    assert (told.code, told.severity, told.span) == ("cut-disputed", "doubtful", (float(graph.t[29]), t))
    assert told.value == pytest.approx(4.0)
    assert cuts_disputed(graph, ()) == ()
    for code, at, times, excused in (
        ("scene-change", t, 1, True),
        ("wheels-set", t, 1, True),
        ("scene-change", t + 5.0, 1, False),
        ("scene-jump", t + 5.0, 2, True),  # the second may be there
        ("stamp-lag", t, 1, False),
    ):
        known = Finding(code, "1", (at, at), {"times": times})
        assert (cuts_disputed(moved, (known,)) == ()) == excused


def test_places_far_from_where_wheels_lead_over_several_cuts_together_are_told_where_no_place_lies_between():
    """Over each of the two cuts wheels may err by as much, over both they do not; a place between tells either."""
    graph = straight((30, 32), n=60)
    pose = np.array(graph.pose)
    pose[30:, 1] += 2.7
    assert cuts_disputed(replace(graph, pose=pose), ()) == ()
    pose[32:, 1] += 2.7
    (told,) = cuts_disputed(replace(graph, pose=pose), ())
    assert (told.code, told.span) == ("cut-disputed", (float(graph.t[29]), float(graph.t[32])))
    assert told.value == pytest.approx(5.4)
    held = straight((30, 32), ((10, 31),), n=60)
    assert cuts_disputed(replace(held, pose=pose), ()) == ()


def test_over_a_cut_where_wheels_lead_on_a_few_decimetres_are_no_dispute():
    graph = straight((30,), n=60)
    faded = replace(graph, border=tuple(FADED if why else "" for why in graph.border))
    for off, told in ((0.45, 0), (1.5, 1)):
        pose = np.array(graph.pose)
        pose[30:, 1] += off
        assert len(cuts_disputed(replace(faded, pose=pose), ())) == told


def test_a_robot_that_faces_the_other_way_after_a_sharp_turn_is_told():
    graph = straight((30,), n=60)
    step, pose = np.array(graph.step), np.array(graph.pose)
    step[29, 2] = 2.8  # of which wheels may err by a half, as by any share: not by more than a turn
    after = np.arange(30, 60)
    pose[after] = se2.compose(se2.compose(pose[29], step[29] + [0.0, 0.0, np.pi]), se2.between(pose[30], pose[after]))
    (told,) = cuts_disputed(replace(graph, step=step, pose=pose), ())
    assert told.code == "cut-disputed"
