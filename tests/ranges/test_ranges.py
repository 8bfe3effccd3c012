"""Robots and beacons placed by ranges: factors, the search from no guess, what is not observed, ranges too long."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.ranges import _findings
from mapweave.core import se2
from mapweave.core.findings import Finding, verdict
from mapweave.core.records import Track
from mapweave.io.pyfg import write_pyfg
from mapweave.ranges import network as range_log
from mapweave.ranges import start
from mapweave.ranges.estimate import RangeEstimate, _mirrored, _start_at, estimate
from mapweave.ranges.factors import RadioColumns, lasting, motion_factor, range_factor
from mapweave.ranges.network import Motions, RangeLog, RangeNetwork, Ranges, bodies_of, in_pieces, network_of
from mapweave.ranges.noise import RadioNoise, unlikely
from mapweave.ranges.start import BodyLayout, ColdStart, laid_in_pieces, placements
from mapweave.sim.mixed_team import MixedWorld, simulate_mixed

from ..differences import assert_derivative
from .worlds import BIAS, LINE, SQUARE, STILL, driven, log_of, ranged

TWO = {"robot1": driven(SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(SQUARE[::-1] * 1.3, (2.0, 5.0, 2.0))}
BEACONS = {"beacon1": (-2.0, 4.0), "beacon2": (5.0, 1.0)}


def range_findings(log: RangeLog) -> list[Finding]:
    net = network_of(log)
    return _findings(net, estimate(net))


def misses(net: RangeNetwork, found: RangeEstimate, truth: dict[str, Track], beacons: dict) -> dict[str, float]:
    """By how much each is off [m], root mean square, one transform for all."""
    part = found.parts[0]
    true = np.zeros((len(net.owner), 2))
    for k, name in enumerate(net.everybody):
        rows = np.flatnonzero(net.owner == k)
        true[rows] = (
            beacons[name] if name in beacons else se2.interpolate(net.t[rows], truth[name].t, truth[name].pose)[:, :2]
        )
    T = se2.align(part.pose[:, :2], true[part.nodes])
    off = np.hypot(*(se2.act(T, part.pose[:, :2]) - true[part.nodes]).T)
    owner = net.owner[part.nodes]
    return {net.everybody[k]: float(np.sqrt(np.square(off[owner == k]).mean())) for k in np.unique(owner).tolist()}


def test_jacobians_of_ranges_and_motions_equal_finite_differences():
    rng = np.random.default_rng(1)
    x = rng.normal(size=21)
    cov = np.tile(np.diag([1.0, 2.0, 3.0]), (2, 1, 1))
    motions = Motions(np.array([0, 1]), np.array([1, 2]), rng.normal(size=(2, 3)), cov)
    ends, levers, rates = (np.array([0, 1]), np.array([2, 0])), rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2))
    ranges = Ranges(*ends, np.zeros(2), np.ones(2), np.ones(2), *levers, *rates, np.array([-0.4, 0.3]))
    radio = RadioColumns(*(np.array(at) for at in ([9, 10], [11, 12], [13, 14], [15, 16], [17, 18], [19, 20])))
    for factor in (motion_factor(motions), range_factor(ranges, radio, np.ones(2), None)):
        assert_derivative(factor, x)


def test_a_beacon_seen_from_a_straight_way_may_lie_on_either_side_and_from_a_corner_on_one():
    beacon = np.array([2.0, 3.0])
    for way, sides in ((LINE, 2), (SQUARE, 1)):
        q = driven(way, (0.0, 0.0, 0.0)).pose[:, :2]
        z = np.hypot(*(q - beacon).T) + 0.1
        found = placements(q, np.zeros_like(q), z, turns=False)
        assert len(found) == sides
        assert min(np.hypot(*(way.T[:2] - beacon)) for way in found) < 0.15


@pytest.mark.parametrize(("way", "straight"), [(LINE, True), (SQUARE, False)])
def test_the_mirror_image_is_tried_of_a_team_that_drove_straight_though_its_odometry_turned(way, straight):
    team = {"robot1": driven(way, (0.0, 0.0, 0.0)), "robot2": driven(way, (1.0, 2.0, 0.4))}
    log = ranged(team, BEACONS)
    wandering = log.odometry["robot1"].pose.copy()
    wandering[:, 1] += 0.02 * wandering[:, 0] ** 2
    bent = replace(log.odometry["robot1"], pose=wandering)
    net = network_of(replace(log, odometry={**log.odometry, "robot1": bent}))
    bodies = bodies_of(net)
    laid = laid_in_pieces(net, bodies, range(len(bodies.turns)), 1)
    best = _start_at(net, bodies, laid.nodes, laid.poses[0])
    image = _mirrored(net, bodies, best)
    assert (image is not None) == straight
    if image is not None:
        np.testing.assert_allclose(image[:, :2], best.pose[:, :2] * (1.0, -1.0), atol=1.0)


def test_biases_that_grow_are_found_and_told():
    log = ranged(TWO, BEACONS)
    assert "range-growth" not in {f.code for f in range_findings(log)}
    net = network_of(replace(log, z=log.z + 0.5 * log.t / log.t.max()))
    found = estimate(net)
    assert max(misses(net, found, TWO, BEACONS).values()) < 0.15
    assert np.mean([radio.growth for radio in found.radios]) == pytest.approx(0.5, abs=0.15)
    assert "range-growth" in {f.code for f in _findings(net, found)}


def hurried(log: RangeLog, times: float = 5.0) -> tuple[RangeLog, dict[str, Track]]:
    """`log`, of robots of `TWO`, and their truth, in a fifth of the time."""
    odometry = {n: replace(k, t=k.t / times) for n, k in log.odometry.items()}
    return replace(log, odometry=odometry, t=log.t / times), {n: replace(k, t=k.t / times) for n, k in TWO.items()}


@pytest.mark.parametrize(("late", "drift"), [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.3)])
def test_ranges_stamped_by_another_clock_than_odometry_are_moved_to_it(late, drift):
    log, truth = hurried(ranged(TWO, BEACONS))
    shift = late + drift * (log.t - log.t.mean()) / np.ptp(log.t)
    net = network_of(replace(log, t=log.t + shift))
    found = estimate(net)
    assert max(misses(net, found, truth, BEACONS).values()) < 0.1
    clocks = [told for told, _ in found.clocks.values()]
    assert np.mean([told.lag for told in clocks]) == pytest.approx(late, abs=0.06)
    assert np.mean([told.drift for told in clocks]) == pytest.approx(drift, abs=0.12)
    told_of = {f.code for f in _findings(net, found)}
    assert ("range-lag" in told_of) == (late != 0.0)


def test_stamps_that_are_rounded_are_told_by_ranges_that_err_the_more_the_faster_robots_drive():
    log, truth = hurried(ranged(TWO, BEACONS))
    assert estimate(network_of(log)).jitter < 0.03
    net = network_of(replace(log, t=np.round(log.t)))
    found = estimate(net)
    assert found.jitter == pytest.approx(np.sqrt(1 / 12), rel=0.4)
    assert max(misses(net, found, truth, BEACONS).values()) < 0.1


def test_stamps_that_slow_robots_tell_little_of_are_not_held_where_they_were():
    log = log_of(simulate_mixed(MixedWorld(ranges=True, beacons=3, lasers=3, bearings=0, cameras=0, minutes=1.5), 105))
    late = estimate(network_of(replace(log, t=log.t + 0.3))).clocks
    assert [told.lag for told, _ in late.values()] == pytest.approx([0.3] * 3, abs=0.1)
    assert max(abs(told.lag) for told, _ in estimate(network_of(log)).clocks.values()) < 0.08


def test_odometry_that_slips_for_long_counts_less_then_and_bends_nobody():
    log = ranged(TWO, BEACONS)
    track = log.odometry["robot1"]
    way = se2.between(track.pose[:-1], track.pose[1:])
    way[75:150, :2] *= 0.5
    pose = [track.pose[0]]
    for step in way:
        pose.append(se2.compose(pose[-1], step))
    net = network_of(replace(log, odometry={**log.odometry, "robot1": replace(track, pose=np.array(pose))}))
    found = estimate(net)
    assert {slip.robot for slip in found.slips if slip.times > 3.0} == {"robot1"}
    assert max(misses(net, found, TWO, BEACONS).values()) < 0.12
    assert not [slip for slip in estimate(network_of(log)).slips if slip.times > 1.5]


def test_a_beacon_that_is_moved_makes_a_doubtful_map():
    log = ranged(TWO, BEACONS)
    assert "ranges-drift" not in {f.code for f in range_findings(log)}
    moved = 1.5 * (log.t > 0.5 * log.t.max()) * (log.b == 2)
    told = [f for f in range_findings(replace(log, z=log.z + moved)) if f.code == "ranges-drift"]
    assert len(told) == 1
    assert verdict(told) == "doubtful"
    assert told[0].value["value"] > 0.3


@pytest.mark.parametrize("nlos", [0.0, 0.2])
def test_robots_and_beacons_are_placed_from_no_guess_with_bias_and_noise_of_every_pair(nlos):
    net = network_of(ranged(TWO, BEACONS, nlos))
    found = estimate(net)
    assert found.loose == {}
    assert len(found.parts) == 1
    assert not found.parts[0].mirrored
    off = misses(net, found, TWO, BEACONS)
    assert set(off) == {*TWO, *BEACONS}
    assert max(off.values()) < 0.12
    for radio in found.radios:
        assert radio.bias == pytest.approx(BIAS, abs=3.0 * radio.bias_sd)
        assert radio.bias_sd < 0.15
        assert radio.sd == pytest.approx(0.05, rel=0.3)
        assert radio.far / radio.n == pytest.approx(nlos, abs=0.06)


@pytest.mark.parametrize("anew", [False, True])
def test_a_robot_that_was_carried_or_whose_odometry_began_anew_is_laid_by_its_ranges(anew):
    still = ranged(TWO, BEACONS)
    half = len(TWO["robot1"].t) // 2
    there = TWO["robot1"].pose.copy()
    told = still.odometry["robot1"].pose.copy()
    if anew:
        told[half:] = se2.between(told[half], told[half:])
    else:
        there[half:, :2] += (2.5, -2.0)
    truth = {**TWO, "robot1": replace(TWO["robot1"], pose=there)}
    odometry = {**still.odometry, "robot1": replace(still.odometry["robot1"], pose=told)}
    net = network_of(replace(ranged(truth, BEACONS), odometry=odometry))
    found = estimate(net)
    (k,) = found.denied
    assert net.t[net.motions.first[k]] == pytest.approx(truth["robot1"].t[half], abs=0.8)
    off = misses(net, found, truth, BEACONS)
    assert max(off[name] for name in ("robot2", "beacon1", "beacon2")) < 0.1
    assert off["robot1"] < 0.3  # the instants beside the cut may be told by the wrong side
    assert not estimate(network_of(still)).denied


def test_a_beacon_beside_a_straight_way_is_placed_and_its_mirror_image_is_told():
    truth = {"robot1": driven(LINE, (0.0, 0.0, 0.0))}
    part = estimate(network_of(ranged(truth, {"beacon1": (2.0, 3.0)}))).parts[0]
    assert len(part.mirrored) == 1
    assert {round(part.pose[-1, 1]), round(part.mirrored[0][-1, 1])} == {-3, 3}


@pytest.mark.slow
def test_odometry_whose_heading_drifts_by_radians_places_every_beacon_all_the_same():
    """Laid as a whole the way fits a beacon nowhere, and another where it is not."""
    laps = np.tile([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]], (4, 1))
    truth = {"robot1": driven(laps, (0.0, 0.0, 0.0), 150.0)}
    beacons = {"beacon1": (10.0, 8.0), "beacon2": (40.0, 10.0), "beacon3": (5.0, 30.0)}
    log = ranged(truth, beacons, noise=0.3)
    log = replace(log, **{name: getattr(log, name)[::3] for name in ("a", "b", "t", "z")})
    odometry = log.odometry["robot1"]
    step = np.asarray(se2.between(odometry.pose[:-1], odometry.pose[1:]))
    step[:, 2] += 0.01 * np.hypot(step[:, 0], step[:, 1])
    pose = np.zeros((len(odometry.t), 3))
    for k in range(len(step)):
        pose[k + 1] = se2.compose(pose[k], step[k])
    net = network_of(replace(log, odometry={"robot1": Track(odometry.t, pose)}))
    found = estimate(net)
    assert not found.loose
    assert max(misses(net, found, truth, beacons).values()) < 0.3
    assert verdict(_findings(net, found)) == "good"


def test_ways_in_pieces_are_of_equal_length_and_beacons_stay_whole():
    far = {"robot1": driven(10.0 * SQUARE, (0.0, 0.0, 0.0)), "robot2": driven(3.0 * LINE, (0.0, 0.0, 0.0))}
    bodies = bodies_of(network_of(ranged(far, BEACONS)))
    fine, whose = in_pieces(bodies, 4)
    assert np.bincount(whose).tolist() == [4, 1, 1, 1]  # 18 m are not cut
    np.testing.assert_array_equal(whose[fine.of], bodies.of)
    np.testing.assert_array_equal(fine.pose, bodies.pose)
    for piece in np.flatnonzero(fine.turns).tolist():
        of = bodies.of == whose[piece]
        here = fine.of == piece
        whole, part = (np.hypot(*np.diff(bodies.pose[k, :2], axis=0).T).sum() for k in (of, here))
        assert part == pytest.approx(whole / (whose == whose[piece]).sum(), rel=0.05)


def test_layouts_in_which_the_robot_that_most_ranged_to_is_not_placed_lie_in_the_frame_of_another(monkeypatch):
    net = network_of(ranged(TWO, BEACONS))
    moved = np.array([1.0, 2.0, 0.5])
    layouts = {
        0: BodyLayout({0: np.zeros(3)}, 0.0),
        1: BodyLayout({1: moved, 2: np.ones(3)}, 0.0),
    }
    monkeypatch.setattr(start, "_laid_from", lambda first, *_: ColdStart((layouts[first],), {}))
    monkeypatch.setattr(start, "_firsts", lambda *_: [0, 1])
    laid = start.lay_out(net, bodies_of(net), [0, 1, 2, 3]).layouts
    assert [set(layout.frames) for layout in laid] == [{1, 2}]
    np.testing.assert_allclose(se2.between(laid[0].frames[1], laid[0].frames[2]), se2.between(moved, np.ones(3)))


def test_a_robot_that_stands_is_placed_and_its_heading_told_to_be_unobserved():
    truth = {"robot1": TWO["robot1"], "robot2": driven(STILL, (1.0, 4.0, 0.5))}
    net = network_of(ranged(truth, {}))
    part = estimate(net).parts[0]
    assert part.still == ("robot2",)
    assert max(misses(net, estimate(net), truth, {}).values()) < 0.15
    assert np.sqrt(part.cov[-1, 2, 2]) > 1.0


def test_a_robot_that_nobody_ranged_to_stays_in_a_map_of_its_own_and_is_named():
    log = ranged({**TWO, "robot3": driven(SQUARE, (9.0, 0.0, 0.0))}, BEACONS)
    keep = (log.a != 2) & (log.b != 2)
    found = estimate(network_of(replace(log, a=log.a[keep], b=log.b[keep], t=log.t[keep], z=log.z[keep])))
    assert list(found.loose) == ["robot3"]
    assert [len(part.nodes) for part in found.parts] == sorted((len(part.nodes) for part in found.parts), reverse=True)
    assert len(found.parts) == 2


def test_two_robots_that_stand_are_not_placed():
    truth = {"robot1": driven(STILL, (0.0, 0.0, 0.0)), "robot2": driven(STILL, (1.0, 4.0, 0.5))}
    assert "too little motion" in estimate(network_of(ranged(truth, {}))).loose["robot2"]


def test_surveyed_beacons_hold_the_frame():
    log = replace(ranged(TWO, BEACONS), known={name: (*at, 0.01) for name, at in BEACONS.items()})
    net = network_of(log)
    part = estimate(net).parts[0]
    assert part.first is None
    true = se2.interpolate(net.t[net.owner == 0], TWO["robot1"].t, TWO["robot1"].pose)
    assert np.hypot(*(part.pose[net.owner == 0] - true)[:, :2].T).max() < 0.1


def test_ranges_that_cannot_be_are_dropped_and_counted():
    log = ranged(TWO, BEACONS)
    odd = RangeLog(
        log.odometry,
        log.names,
        np.append(log.a, [0, 0, 0, 0, 0]),
        np.append(log.b, [0, 1, 1, 1, 2]),
        np.append(log.t, [1.0, 1.0, 1.0, 1.0, 99.0]),
        np.append(log.z, [1.0, -2.0, np.nan, 0.0, 3.0]),
    )
    net = network_of(odd)
    assert len(net.ranges) == len(log.z)
    assert net.dropped == {
        "range to itself": 1,
        "range that is no positive number": 3,
        "range while odometry is silent": 1,
    }


@pytest.mark.parametrize("nlos", [0.0, 0.2])
def test_places_of_robots_err_as_they_say(nlos):
    nees = []
    for seed in range(2):
        team = mapweave.simulate_team(ranges=True, beacons=4, nlos=nlos, minutes=1.0, seed=seed)
        truth = {r.name: r.truth for r in team.robots}
        names = (*truth, *team.landmarks)
        ends = [np.concatenate([np.full(len(r.t), names.index(getattr(r, k))) for r in team.ranges]) for k in "ab"]
        t, z = (np.concatenate([getattr(r, k) for r in team.ranges]) for k in "tz")
        net = network_of(RangeLog({r.name: r.odometry for r in team.robots}, names, *ends, t, z))
        part = estimate(net).parts[0]
        true = np.array(
            [
                se2.interpolate(net.t[[k]], truth[name].t, truth[name].pose)[0, :2]
                if (name := net.everybody[net.owner[k]]) in truth
                else team.landmarks[name]
                for k in part.nodes
            ]
        )
        e = part.pose[:, :2] - se2.act(se2.align(true, part.pose[:, :2]), true)
        driven = ~net.is_beacon[part.nodes]
        P = part.cov[driven][:, :2, :2]
        nees.append(float(np.einsum("ni,nij,nj->n", e[driven], np.linalg.inv(P), e[driven]).mean() / 2))
        assert np.sqrt(np.trace(P, axis1=1, axis2=2)).mean() < 0.05  # not the metre that the frame's own heading makes
    assert 0.5 < np.mean(nees) < 2.0


def test_errors_that_last_are_told_from_those_that_do_not():
    rng = np.random.default_rng(0)
    white = rng.standard_normal(4000)
    slow = np.zeros(4000)
    for k in range(1, 4000):
        slow[k] = 0.8 * slow[k - 1] + white[k]
    assert lasting(white) == pytest.approx(1.0, abs=0.2)
    assert lasting(slow) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.25)


def test_wheels_are_less_sure_of_a_step_by_its_way_by_its_turn_and_by_the_time_it_takes():
    c = range_log
    for step, dt, heading in (
        ([2.0, 0.0, 0.0], 0.0, c.DRIFT**2 * 2.0),
        ([0.0, 0.0, -0.5], 0.0, c.TURN**2 * 0.5),
        ([0.0, 0.0, 0.0], 3.0, c.REST_THETA**2 * 3.0),
    ):
        _, var = c.steps(np.array([np.zeros(3), step]), np.array([0.0, dt]))
        along, across = (k**2 * step[0] + c.REST_XY**2 * dt for k in (c.ALONG, c.ACROSS))
        np.testing.assert_allclose(var[0], [along, across, heading], atol=2e-8)


@pytest.mark.parametrize("nlos", [0.0, 0.2])
def test_the_noise_of_a_radio_is_neither_more_nor_less_than_its_ranges_scatter(nlos):
    rng = np.random.default_rng(3)
    n, pairs = 400, 60
    which = np.repeat(np.arange(pairs), n)
    error = rng.normal(0.0, 0.05, n * pairs) + np.where(
        rng.random(n * pairs) < nlos, rng.uniform(0.5, 3.0, n * pairs), 0.0
    )
    nobody = np.zeros(n * pairs, np.int64)
    t = np.tile(np.arange(float(n)), pairs)
    ranges = Ranges.of_points(nobody, nobody, t, error, np.full(n * pairs, np.nan))
    told = RadioNoise.of(ranges, which, pairs, error)
    assert np.sqrt(np.mean(np.square(told.sd))) == pytest.approx(0.05, rel=0.03)
    assert (told.far == (error > 0.4)).mean() > 0.99


@pytest.mark.parametrize("sd", [1e-5, 0.05])
def test_noise_and_bias_are_found_from_the_log_whatever_a_graph_states_of_its_ranges(sd):
    net = network_of(ranged(TWO, BEACONS))
    net = replace(net, ranges=replace(net.ranges, sd=np.full(len(net.ranges), sd)))
    found = estimate(net)
    assert max(misses(net, found, TWO, BEACONS).values()) < 0.1
    assert found.radios[0].sd == pytest.approx(0.05, rel=0.3)
    assert found.radios[0].bias == pytest.approx(BIAS, abs=0.05)
    assert ("ranges-worse" in {f.code for f in _findings(net, found)}) == (sd < 0.01)


def test_a_graph_that_states_metres_of_error_of_its_odometry_makes_no_good_map(tmp_path):
    log, verdicts = ranged(TWO, {}), {}
    log = replace(log, **{name: getattr(log, name)[::10] for name in ("a", "b", "t", "z")})
    net = network_of(log)
    net = replace(net, ranges=replace(net.ranges, sd=np.full(len(net.ranges), 0.05)))
    for sd in (0.02, 1.0):
        cov = np.tile(np.diag([sd**2, sd**2, sd**2]), (len(net.motions.z), 1, 1))
        write_pyfg(
            tmp_path / "graph.pyfg", replace(net, motions=replace(net.motions, cov=cov)), np.zeros((len(net.t), 3))
        )
        solved = mapweave.solve_ranges(tmp_path / "graph.pyfg")
        verdicts[sd] = solved.verdict, {f.robot for f in solved.findings if f.code == "way-loose"}
    assert verdicts == {0.02: ("good", set()), 1.0: ("doubtful", {"A", "B"})}


@pytest.mark.parametrize(
    ("seed", "team"),
    [
        (15, {"lasers": 3, "nlos": 0.1, "noise": 0.5}),
        (14, {"lasers": 2, "beacons": 1, "nlos": 0.1, "noise": 2.0, "rooms": 2}),
        (145, {"lasers": 3, "beacons": 1, "nlos": 0.1, "noise": 2.0, "rooms": 2}),  # found from some robots alone
    ],
)
def test_of_layouts_the_likeliest_is_found_not_the_one_that_noisier_ranges_would_fit_best(seed, team):
    made = mapweave.simulate_team(ranges=True, cameras=0, bearings=0, minutes=0.5, seed=seed, **{"rooms": 1, **team})
    net = network_of(log_of(made))
    truth = {robot.name: robot.truth for robot in made.robots}
    assert max(misses(net, estimate(net), truth, made.landmarks).values()) < 0.3


def test_a_pairs_ranges_are_as_likely_as_a_chain_whose_errors_last_so_long():
    rng, rho, sd, n = np.random.default_rng(3), 0.8, 0.1, 4000
    e = np.zeros(n)
    for k in range(1, n):
        e[k] = rho * e[k - 1] + sd * np.sqrt(1.0 - rho**2) * rng.standard_normal()
    new = e[1:] - rho * e[:-1]
    chain = np.square(new / sd).sum() / (1.0 - rho**2) + (n - 1) * np.log(2.0 * np.pi * sd**2 * (1.0 - rho**2))
    nobody = np.zeros(n, int)
    r = Ranges.of_points(nobody, nobody, np.arange(float(n)), e, np.full(n, np.nan))
    far = np.zeros(n, bool)
    which, long = np.zeros(n, int), np.array([(1.0 + rho) / (1.0 - rho)])
    each = np.full(n, sd)
    told = unlikely(RadioNoise(e, far, np.array([sd]), long, each), r, which)
    assert told == pytest.approx(chain, abs=0.05 * n)
    assert unlikely(RadioNoise(e, far, np.array([sd]), np.ones(1), each), r, which) > told + n
