"""Sparse Gauss-Newton and Levenberg-Marquardt in information form, robust kernels, marginal covariances.

A `Problem` is one vector of variables and vectorised `Factor`s over it; `minimise` gives a `Solution` that says how
it ended; `Information` is the factorised information matrix, whose inverse is the covariance. A handful of variables
takes `gauss_newton`.
"""

from .information import Information, Pattern, SingularError
from .optimise import DenseSolution, Solution, SolveConfig, SolveStatus, gauss_newton, minimise
from .problem import Cauchy, Factor, GemanMcClure, Huber, Kernel, Problem, Term, wrapping

__all__ = [
    "Cauchy",
    "DenseSolution",
    "Factor",
    "GemanMcClure",
    "Huber",
    "Information",
    "Kernel",
    "Pattern",
    "Problem",
    "SingularError",
    "Solution",
    "SolveConfig",
    "SolveStatus",
    "Term",
    "gauss_newton",
    "minimise",
    "wrapping",
]
