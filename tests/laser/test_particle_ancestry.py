"""Who is resampled takes over all that its ancestor was: pose, map and the likelihood of the whole past."""

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Event, Scan
from mapweave.laser.config import FilterConfig
from mapweave.laser.particle_slam import init, step, trajectory
from mapweave.mapping.config import LaserConfig

BEAMS = 121
SCATTERED = FilterConfig(sd_xy=0.1, refine_iterations=0)  # particles that differ enough for some to die


def box_scan(pose):
    """What a scanner sees in the middle of a room of 6 x 4 m, with odometry that is right."""
    angle = np.linspace(-2.0, 2.0, BEAMS)
    a = angle + pose[2]
    tx = (np.sign(np.cos(a)) * 3.0 - pose[0]) / np.cos(a)
    ty = (np.sign(np.sin(a)) * 2.0 - pose[1]) / np.sin(a)
    hit = np.ones(BEAMS, bool)
    return Scan(np.minimum(tx, ty), hit, None, -2.0, float(angle[1] - angle[0]), 30.0, odometry=pose)


def steps(cfg, particles):
    """The state after every scan of a drive to and fro, and the totals before each."""
    rng = np.random.default_rng(5)
    state = init("1", cfg, rng, feature="none")
    x = np.concatenate([np.linspace(-1.3, 1.3, 7), np.linspace(0.9, -1.3, 6)])
    for k, pose in enumerate(np.column_stack([x, 0.1 * np.sin(x), np.full(len(x), 0.05)])):
        before = state.total.copy()
        state, _ = step(state, Event(float(k), "1", box_scan(pose)), cfg, rng)
        assert len(state.total) == particles
        yield before, state


def test_children_of_one_ancestor_have_one_likelihood_of_the_past():
    cfg = LaserConfig(particles=12, resample=1.0, threads=1, filter=SCATTERED)
    siblings = others = 0
    for _, state in steps(cfg, 12):
        _, _, ancestors = state.history[-1]
        for i in range(12):
            same = ancestors == ancestors[i]
            assert (state.total[same] == state.total[i]).all()
            siblings += int(same.sum()) - 1
            others += int((state.total[~same] != state.total[i]).sum())
    assert siblings > 20
    assert others > 20


def test_without_resampling_likelihoods_add_up_and_weights_keep_them():
    cfg = LaserConfig(particles=12, resample=0.0, threads=1)
    for before, state in steps(cfg, 12):
        assert (state.total <= before).all()
        np.testing.assert_allclose(state.log_weight, state.total, atol=1e-12)
    assert np.ptp(state.total) > 0.1


def test_the_answer_is_the_likeliest_particle_and_its_ancestors():
    cfg = LaserConfig(particles=12, resample=1.0, threads=1, filter=SCATTERED)
    *_, (_, state) = steps(cfg, 12)
    poses = trajectory(state)
    i, moved = int(np.argmax(state.total)), 0
    for row, now, ancestors in reversed(state.history):
        np.testing.assert_allclose(poses[row], now[i], atol=1e-12)
        moved += int(ancestors[i] != i)
        i = int(ancestors[i])
    assert moved
    assert np.abs(se2.between(poses[0], poses[-1])[:2]).max() < 0.1
