"""Trajectories laid by position fixes: consistent, robust to jumps and receivers that say too little, from no guess."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.ranges.fixes import Laid, Sights, fix_factor, lay, mirrored, registered, turn_sd
from mapweave.ranges.network import Motions

from ..differences import assert_derivative

STEP_SD, TURN_SD = 0.02, 0.004  # [m], [rad] of a motion of half a metre
ARM = np.array([0.3, 0.1])


class Drive:
    """A winding drive of 150 m, anywhere; a fix every third pose, `jumps` of them up to hundreds of metres off."""

    def __init__(self, seed: int, *, sd: float = 1.0, jumps: float = 0.0, times: float = 1.0, told: bool = True):
        rng, n = np.random.default_rng(seed), 300
        step = np.column_stack([np.full(n - 1, 0.5), np.zeros(n - 1), 0.02 + 0.3 * rng.standard_normal(n - 1)])
        noise = np.column_stack([STEP_SD * rng.standard_normal((n - 1, 2)), TURN_SD * rng.standard_normal(n - 1)])
        self.truth = chained(np.array([*(100 * rng.standard_normal(2)), rng.uniform(-3, 3)]), step)
        z = np.asarray(se2.compose(step, noise))
        self.pose = chained(np.zeros(3), z)
        cov = np.tile(np.diag([STEP_SD**2, STEP_SD**2, TURN_SD**2]), (n - 1, 1, 1))
        self.motions = Motions(np.arange(n - 1), np.arange(1, n), z, cov)
        rows = np.arange(0, n, 3)
        fix = se2.act(self.truth[rows], ARM) + times * sd * rng.standard_normal((len(rows), 2))
        self.wrong = rng.random(len(rows)) < jumps
        fix[self.wrong] += 100 * rng.standard_normal((int(self.wrong.sum()), 2))
        said = np.tile(sd**2 * np.eye(2) if told else np.full((2, 2), np.nan), (len(rows), 1, 1))
        arm = np.tile(ARM, (len(rows), 1))
        self.sights = Sights(rows, arm, fix, said, 1.0 * rows, np.zeros(len(rows), np.int64))

    def laid(self) -> Laid:
        T, _ = registered(self.sights.at(self.pose), self.sights.z)
        found = lay(se2.compose(T, self.pose), self.motions, self.sights)
        assert found is not None
        return found

    def nees(self, found: Laid) -> float:
        """Of poses in the world, a degree of freedom."""
        e = found.pose - self.truth
        e[:, 2] = se2.wrap_angle(e[:, 2])
        return float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.covariances()), e).mean() / 3)

    def relative_nees(self, found: Laid) -> float:
        """Of poses seen from the first."""
        e = se2.between(found.pose[0], found.pose) - se2.between(self.truth[0], self.truth)
        e[:, 2] = se2.wrap_angle(e[:, 2])
        P = found.relative(0)[1:]
        return float(np.einsum("ni,nij,nj->n", e[1:], np.linalg.inv(P), e[1:]).mean() / 3)


def chained(first: np.ndarray, steps: np.ndarray) -> np.ndarray:
    out = [first]
    for step in steps:
        out.append(np.asarray(se2.compose(out[-1], step)))
    return np.array(out)


@pytest.mark.parametrize(
    "kind",
    [{}, {"jumps": 0.3}, {"jumps": 0.45}, {"told": False}, {"times": 3.0}, {"sd": 0.05}],
    ids=["clean", "jumps", "nearly-half-jumps", "noise-untold", "worse-than-told", "centimetres"],
)
def test_poses_in_the_world_and_from_the_first_err_as_they_say(kind):
    drives = [Drive(seed, **kind) for seed in range(12)]
    found = [d.laid() for d in drives]
    assert 0.5 < np.mean([d.nees(f) for d, f in zip(drives, found, strict=True)]) < 2.0
    assert 0.5 < np.mean([d.relative_nees(f) for d, f in zip(drives, found, strict=True)]) < 2.0
    for d, f in zip(drives, found, strict=True):
        assert (f.far & ~d.wrong).sum() <= 3
        off = np.hypot(*(d.sights.z - se2.act(d.truth[d.sights.node], ARM)).T)
        assert f.far[off > 20.0].all()


def test_what_a_receiver_errs_is_found_whatever_it_says():
    honest, worse, untold = (Drive(3, **kind).laid() for kind in ({}, {"times": 3.0}, {"sd": 0.4, "told": False}))
    assert honest.receivers.scale[0] == pytest.approx(1.0, abs=0.2)
    assert worse.receivers.scale[0] == pytest.approx(3.0, abs=0.6)
    assert untold.receivers.scale[0] == pytest.approx(0.4, abs=0.1)


def test_a_receiver_that_says_less_than_it_errs_is_never_believed_more():
    drive = Drive(5, sd=2.0, times=0.1)
    assert drive.laid().receivers.scale[0] == 1.0


def test_errors_that_last_count_as_so_many_fewer_fixes():
    drive = Drive(1)
    rng = np.random.default_rng(0)
    slow = np.repeat(rng.standard_normal((10, 2)), 10, axis=0)[: len(drive.sights.t)]
    z = se2.act(drive.truth[drive.sights.node], ARM) + slow
    drive.sights = replace(drive.sights, z=z)
    # `lasting` asks for a hundred residuals before it says anything: there are as many fixes
    assert drive.laid().receivers.lasting[0] > 2.0


def test_the_jacobian_of_a_fix_equals_finite_differences():
    rng = np.random.default_rng(1)
    x = rng.normal(size=9)
    sights = Sights(
        np.array([0, 2]),
        rng.normal(size=(2, 2)),
        rng.normal(size=(2, 2)),
        np.ones((2, 2, 2)),
        np.zeros(2),
        np.zeros(2, np.int64),
    )
    factor = fix_factor(sights, np.tile(np.diag([1.0, 4.0]), (2, 1, 1)), None)
    assert_derivative(factor, x)


def test_fixes_of_the_wrong_hemisphere_are_told_from_right_ones_and_a_straight_way_is_not_accused():
    drive = Drive(2)
    p, z = drive.sights.at(drive.pose), drive.sights.z
    assert not mirrored(p, z)
    assert mirrored(p, z * np.array([1.0, -1.0]))
    line = np.column_stack([np.linspace(0, 50, 60), np.zeros(60)])
    noise = 0.5 * np.random.default_rng(1).standard_normal((60, 2))
    assert not mirrored(line, line + noise)
    assert not mirrored(line, line * np.array([-1.0, 1.0]) + noise)


def test_how_well_a_heading_is_told_is_the_noise_over_the_way():
    line = np.column_stack([np.linspace(-10, 10, 50), np.zeros(50)])
    rng = np.random.default_rng(1)
    turns = [se2.align(line, line + 0.5 * rng.standard_normal(line.shape))[2] for _ in range(300)]
    assert turn_sd(line, 0.5) == pytest.approx(np.std(turns) * np.sqrt(2), rel=0.2)  # all spread is along one axis
    assert turn_sd(np.zeros((50, 2)), 0.5) > 1e6
