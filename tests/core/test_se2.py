"""SE(2) group laws and Jacobians."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapweave.core import se2

finite = st.floats(-50, 50)
poses = st.tuples(finite, finite, st.floats(-3.1, 3.1)).map(np.array)


def close(a, b):
    d = a - b
    d[..., 2] = se2.wrap_angle(d[..., 2])
    return np.abs(d).max() < 1e-9


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    assert close(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(poses)
def test_a_pose_composed_with_its_inverse_is_the_identity(a):
    assert close(se2.compose(a, se2.inverse(a)), np.zeros(3))
    assert close(se2.compose(se2.inverse(a), a), np.zeros(3))


@given(poses)
def test_exp_undoes_log(a):
    assert close(se2.exp(se2.log(a)), a)


@given(poses, poses)
def test_between_is_the_second_pose_seen_from_the_first(a, b):
    assert close(se2.compose(a, se2.between(a, b)), b)


@given(poses, poses, finite, finite)
def test_acting_twice_is_acting_with_the_composition(a, b, x, y):
    p = np.array([x, y])
    assert np.allclose(se2.act(se2.compose(a, b), p), se2.act(a, se2.act(b, p)), atol=1e-9)


def test_wrap_brings_every_angle_into_minus_pi_exclusive_to_pi():
    assert se2.wrap_angle(np.pi) == np.pi
    assert se2.wrap_angle(-np.pi) == np.pi
    assert abs(se2.wrap_angle(7.0) - (7 - 2 * np.pi)) < 1e-15


def numeric(f, x):
    """Derivative of a pose-valued f by central differences, headings wrapped."""
    columns = []
    for k in range(3):
        d = np.zeros(3)
        d[k] = 1e-6
        diff = f(x + d) - f(x - d)
        diff[..., 2] = se2.wrap_angle(diff[..., 2])
        columns.append(diff / 2e-6)
    return np.stack(columns, axis=-1)


def test_jacobians_agree_with_central_differences():
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-3, 3, (2, 20, 3))
    for f, jacobians in ((se2.compose, se2.compose_jacobians), (se2.between, se2.between_jacobians)):
        A, B = jacobians(a, b)
        np.testing.assert_allclose(A, numeric(lambda x, f=f: f(x, b), a), atol=1e-8)
        np.testing.assert_allclose(B, numeric(lambda x, f=f: f(a, x), b), atol=1e-8)
    np.testing.assert_allclose(se2.inverse_jacobian(a), numeric(se2.inverse, a), atol=1e-8)


def test_one_pose_and_many_are_composed_inverted_and_wrapped_to_the_same_bits():
    rng = np.random.default_rng(4)
    a, b = (np.column_stack([rng.normal(0.0, 30.0, (500, 2)), rng.uniform(-9.0, 9.0, 500)]) for _ in range(2))
    a[:9, 2], b[:9, 2] = np.repeat([np.pi, -np.pi, 0.0], 3), np.tile([np.pi, -np.pi, 0.0], 3)
    a[9, 2], b[10, 0] = np.nan, np.inf
    for one, many in (
        ([se2.compose(p, q) for p, q in zip(a, b, strict=True)], se2.compose(a, b)),
        ([se2.between(p, q) for p, q in zip(a, b, strict=True)], se2.between(a, b)),
        ([se2.wrap_angle(p) for p in a[:, 2].tolist()], se2.wrap_angle(a[:, 2])),
    ):
        assert np.array(one).tobytes() == np.asarray(many).tobytes()


def test_jacobians_of_one_pose_and_of_many_are_the_same():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(-3, 3, 3), rng.uniform(-3, 3, (4, 5, 3))
    for jacobians in (se2.compose_jacobians, se2.between_jacobians):
        A, B = jacobians(a, b)
        assert A.shape == B.shape == (4, 5, 3, 3)
        one = jacobians(a, b[2, 3])
        np.testing.assert_array_equal(A[2, 3], one[0])
        np.testing.assert_array_equal(B[2, 3], one[1])
    np.testing.assert_array_equal(se2.inverse_jacobian(b)[1, 2], se2.inverse_jacobian(b[1, 2]))
    np.testing.assert_array_equal(se2.rotation(b[..., 2])[1, 2], se2.rotation(b[1, 2, 2]))


def test_covariances_are_carried_as_sampled_errors_are():
    rng = np.random.default_rng(2)
    a, b = np.array([1.0, -2.0, 0.7]), np.array([[3.0, 1.0, -0.4], [-2.0, 0.5, 2.0]])
    roots = 1e-3 * rng.normal(size=(3, 3, 3))
    Pa, Pb = roots[0] @ roots[0].T, roots[1:] @ roots[1:].swapaxes(1, 2)
    P = se2.composed_covariance(a, Pa, b, Pb)
    for k in range(2):
        drawn = se2.compose(
            a + rng.normal(size=(200_000, 3)) @ roots[0].T, b[k] + rng.normal(size=(200_000, 3)) @ roots[1 + k].T
        )
        np.testing.assert_allclose(np.cov(drawn.T), P[k], atol=0.02 * np.abs(P[k]).max())
    seen = se2.rotation(0.7) @ (1e-3 * rng.normal(size=(2, 3)))
    full = np.vstack([seen, np.ones(3)])
    before = np.vstack([se2.rotation(-0.7) @ seen, np.ones(3)])
    np.testing.assert_allclose(se2.turned_covariance(0.7, before @ before.T), full @ full.T, atol=1e-12)


def test_interpolation_takes_the_shorter_arc():
    poses = np.array([[0.0, 0, 3.0], [1.0, 2, -3.0]])
    mid = se2.interpolate(np.array([0.5]), np.array([0.0, 1.0]), poses)[0]
    assert np.allclose(mid[:2], [0.5, 1.0])
    assert abs(abs(mid[2]) - np.pi) < 1e-9


def test_align_recovers_a_rigid_transform():
    rng = np.random.default_rng(1)
    T = np.array([1.0, -2.0, 2.5])
    p = rng.normal(size=(6, 2))
    assert np.allclose(se2.align(p, se2.act(T, p), rng.uniform(0.1, 1, 6)), T)


def matrix(x, y, z, w):
    """The rotation of a quaternion, by turning the axes: q v q*."""

    def product(a, b):
        return np.array([
            a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
            a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
            a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
            a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
        ])  # fmt: skip

    q, back = np.array([x, y, z, w]), np.array([-x, -y, -z, w])
    return np.array([product(product(q, np.append(e, 0.0)), back)[:3] for e in np.eye(3)]).T


def test_the_heading_of_a_quaternion_is_that_of_the_x_axis_seen_from_above_and_it_may_stand_on_its_head():
    rng = np.random.default_rng(3)
    heads = 0
    for q in rng.normal(size=(50, 4)).tolist():
        R = matrix(*q)
        assert abs(se2.wrap_angle(se2.heading_of_quaternion(*q) - np.arctan2(R[1, 0], R[0, 0]))) < 1e-9
        assert se2.is_upside_down(*q) == (R[2, 2] < 0)
        heads += int(R[2, 2] < 0)
    assert 10 < heads < 40


def test_headings_come_back_from_quaternions():
    for theta in (*np.linspace(-3.1, 3.1, 41).tolist(), np.pi, -np.pi):
        q = se2.quaternion_of_heading(theta)
        assert abs(se2.wrap_angle(se2.heading_of_quaternion(*q) - theta)) < 1e-11
        assert abs(se2.wrap_angle(se2.heading_of_quaternion(*(-3.0 * v for v in q)) - theta)) < 1e-11
        assert not se2.is_upside_down(*q)
        kept = se2.representable_heading(theta + 4 * np.pi)
        assert abs(se2.wrap_angle(kept - theta)) < 1e-11
        assert se2.heading_of_quaternion(*se2.quaternion_of_heading(kept)) == kept
