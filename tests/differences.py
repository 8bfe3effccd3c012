"""Central differences, and the law of every factor: its Jacobian is that of its residual."""

import numpy as np


def jacobian(f, x, h=1e-6):
    """Derivative of `f` at x by central differences: the shape of `f(x)`, then a column a number of x."""
    x = np.asarray(x, float)
    return np.stack([(f(x + d) - f(x - d)) / (2 * h) for d in h * np.eye(x.size).reshape(-1, *x.shape)], axis=-1)


def assert_derivative(factor, x, atol=1e-6):
    """The Jacobian (m, rows, columns) that a factor gives of itself is that of its residual."""
    every = jacobian(factor.residual, x)
    own = np.take_along_axis(every, factor.columns[:, None, :], axis=2)
    np.testing.assert_allclose(factor.jacobian(x), own, atol=atol)
