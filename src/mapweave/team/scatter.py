"""How errors scatter: what each robot's factors over some seconds pull together, beside what the model says.

A model that is right has pulls with the information of their factors for a covariance. Errors that last, and noise that
is not what was assumed, make them larger or smaller.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from ..solve import Factor, Information, Pattern
from .problem import Origin, TeamProblem

LEAST_CURVED = 0.1  # share of a term's information that its curvature is at least: less would say nothing is known
MOST_TAKEN = 0.95  # share of the errors that residuals may lack: of more they show nothing
FEWEST, SOLVES = (
    4,
    1500,
)  # directions looked at for that share, at least; and solutions for them, about, which take time
CHUNK = 96  # of them at once


@dataclass(frozen=True, slots=True)
class Groups:
    """One robot's factors within `length` [s] are a group: `many` of them for each of `robots`, from `begin` [s] on."""

    begin: float
    length: float
    many: int
    robots: int

    @classmethod
    def of(cls, team: TeamProblem, length: float) -> "Groups":
        begin = min(float(part.instants.t[0]) for part in team.parts)
        end = max(float(part.instants.t[-1]) for part in team.parts)
        return cls(begin, length, int((end - begin) // length) + 1, len(team.parts))

    def __len__(self) -> int:
        return self.many * self.robots

    def rows(self, origin: Origin) -> Int[np.ndarray, " m"]:
        """The group of each factor of a term."""
        k = np.clip((origin.t - self.begin) // self.length, 0, self.many - 1)
        return np.asarray(origin.robot * self.many + k.astype(int))


def scores(team: TeamProblem, x: Float[np.ndarray, " n"], groups: Groups) -> sp.csr_matrix:
    """The pull on every variable of each group of factors, (groups, n)."""
    out = sp.csr_matrix((len(groups), len(x)))
    for term, origin in zip(team.problem.terms, team.origins, strict=True):
        if origin is not None:
            g = term.normal(x)[1]
            row = np.repeat(groups.rows(origin), g.shape[1])
            out = out + sp.csr_matrix((g.ravel(), (row, term.columns.ravel())), shape=out.shape)
    return out


def curved(team: TeamProblem, x: Float[np.ndarray, " n"], pattern: Pattern) -> Information:
    """The information as the costs are curved: that of the solver, but for what the kernels flatten in each term."""
    parts = ((_share(term, x) * block, g) for term in team.factors for block, g in (term.normal(x),))
    return Information.of(pattern.added(parts)[0], pattern.elimination)


def scatter(moved: Float[np.ndarray, "rows q"], groups: int) -> float:
    """By how much the groups' errors scatter more than the model says, squared, in the mean; 1 where nothing shows it.

    moved: how far each of `groups` moves what is looked at, in the model's standard deviations, then each prior, which
    says itself how much it errs and is left out on both sides.
    """
    squares = np.square(moved).sum(axis=1)
    left = moved.shape[1] - float(squares[groups:].sum())
    return float(squares[:groups].sum()) / left if groups and left > 1.0 - MOST_TAKEN else 1.0


def taken_out(
    team: TeamProblem,
    x: Float[np.ndarray, " n"],
    groups: Groups,
    information: Information,
    free: Int[np.ndarray, " f"],
    looked: Float[np.ndarray, "n q"],
) -> float:
    """The share of the groups' errors that their residuals at x lack, were errors as the model says; under 1.

    What few groups saw is fitted to their errors. Errors of group g, whose information is `H_g`, leave
    `H_g - H_g H^-1 H_g` of it in its pull (Bell and McCaffrey, 2002), and move what is `looked` at by
    `C^T H_g C`, `C = H^-1 looked`: the share is the sum of `C^T H_g H^-1 H_g C` over that of `C^T H_g C`, traces over
    the columns of `looked`, or over some of them and some groups where all would be long work.
    """
    if not looked.shape[1]:
        return 0.0
    many = min(max(FEWEST, SOLVES // len(groups)), looked.shape[1])
    some = ((np.arange(many) + 0.5) * looked.shape[1] / many).astype(int)  # spread evenly
    chosen = np.arange(0, len(groups), -(-many * len(groups) // SOLVES))
    C = np.zeros((len(x), len(some)))
    C[free] = information.solve(looked[np.ix_(free, some)])
    held, row, column = [], [np.zeros(0, int)], [np.zeros(0, int)]
    for term, origin in zip(team.factors, team.origins, strict=True):
        if origin is not None:
            held.append((term.columns, _share(term, x) * term.normal(x)[0]))
            row.append(np.repeat(groups.rows(origin), term.columns.shape[1]))
            column.append(term.columns.ravel())
    at, shape = (np.concatenate(row), np.concatenate(column)), (len(groups), len(x))
    missing = total = 0.0
    for c in C.T:
        pulls = [np.einsum("nij,nj->ni", block, c[columns]).ravel() for columns, block in held]
        pull = sp.csr_matrix((np.concatenate([np.zeros(0), *pulls]), at), shape=shape)[chosen][:, free]
        total += float(np.sum(pull @ c[free]))
        for a in range(0, len(chosen), CHUNK):
            u = pull[a : a + CHUNK].toarray()
            missing += float(np.sum(u * information.solve(u.T).T))
    return min(missing / total, MOST_TAKEN) if total > 0 else 0.0


def _share(term: Factor, x: Float[np.ndarray, " n"]) -> float:
    return max(LEAST_CURVED, term.curvature(x))
