"""How well a smoothed team is known: cluster-robust covariances, with a floor.

A model that takes every sighting for independent says millimetres where errors are centimetres: a camera's errors last
for seconds. So the scatter of the scores (each factor's pull) is measured by groups of one robot's factors over some
seconds, and carried through the information matrix ("sandwich"; Liang and Zeger, 1986).

The scatter is what each group's factors pull together, beside what the model says. A model that is right has pulls with
the information of their factors for a covariance. Errors that last, and noise that is not what was assumed, make them
larger or smaller.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from ..core.gaussian import symmetrise
from ..solve import Cauchy, Factor, Information, Pattern, SingularError, Solution
from .config import (
    CLUSTER,
    FEW_RAISED,
    HEADING_FLOOR,
    MOST_CORRECTED,
    POSITION_FLOOR,
    SMOOTHING_GROUPS,
    SMOOTHING_MEMORY,
)
from .problem import Origin, TeamProblem
from .robot_part import PARAMETERS

LEAST_CURVED = 0.1  # share of a term's information that its curvature is at least: less would say nothing is known
MOST_TAKEN = 0.95  # share of the errors that residuals may lack: of more they show nothing
# directions looked at for that share, at least; and solutions for them, about, which take time
FEWEST, SOLVES = 4, 1500
TINY = 1e-12  # keeps the factor of a prior of rank one
UNTOLD = 1e-9  # share of the largest variance: less is a motion of the whole, taken off
FLOOR = np.diag([POSITION_FLOOR**2, POSITION_FLOOR**2, HEADING_FLOOR**2])  # of every pose's covariance
CHUNK = 96  # columns of the covariance, or pulls of groups, held at once


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
    parts = ((_curvature(term, x) * block, g) for term in team.factors for block, g in (term.normal(x),))
    return Information.of(pattern.added(parts)[0], pattern.elimination)


def scatter(influence: Float[np.ndarray, "rows q"], groups: int) -> float:
    """By how much the groups' errors scatter more than the model says, squared, in the mean; 1 where nothing shows it.

    influence: how far each of `groups` moves what is looked at, in the model's standard deviations, then each prior,
    which says itself how much it errs and is left out on both sides.
    """
    squares = np.square(influence).sum(axis=1)
    left = influence.shape[1] - float(squares[groups:].sum())
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
            held.append((term.columns, _curvature(term, x) * term.normal(x)[0]))
            row.append(np.repeat(groups.rows(origin), term.columns.shape[1]))
            column.append(term.columns.ravel())
    at, shape = (np.concatenate(row), np.concatenate(column)), (len(groups), len(x))
    missing = total = 0.0
    for c in C.T:
        pulls = [np.einsum("nij,nj->ni", block, c[columns]).ravel() for columns, block in held]
        pull = sp.csr_matrix((np.concatenate([np.zeros(0), *pulls]), at), shape=shape)[chosen][:, free]
        total += float(np.sum(pull @ c[free]))
        for a in range(0, len(chosen), CHUNK):
            missing += float(information.squares(pull[a : a + CHUNK].toarray().T).sum())
    return min(missing / total, MOST_TAKEN) if total > 0 else 0.0


def _curvature(term: Factor, x: Float[np.ndarray, " n"]) -> float:
    return max(LEAST_CURVED, term.curvature(x))


def weakened(team: TeamProblem, x: Float[np.ndarray, " n"], inflation: Mapping[str, float]) -> list[Factor]:
    """The factors of `team`, each so unsure that a solver's information at x is what `team_covariance` makes of it.

    inflation: of each robot's poses, as smoothing found it.
    """
    out = []
    for term, origin in zip(team.factors, team.origins, strict=True):
        by = 1.0 if team.has_laser else 1.0 / _curvature(term, x)
        by *= 1.0 if origin is None else inflation.get(team.parts[origin.robot].robot, 1.0)
        W = np.ones((1, term.rows)) if term.sqrt_info is None else term.sqrt_info
        kernel = Cauchy(term.kernel.k / np.sqrt(by)) if isinstance(term.kernel, Cauchy) else term.kernel
        out.append(replace(term, sqrt_info=W / np.sqrt(by), kernel=kernel))
    return out


@dataclass(frozen=True, slots=True)
class TeamCovariance:
    """landmarks: (2n, 2n) joint; poses: a robot each, (k, 3, 3); calibration: a robot each, (5,) standard deviations.

    inflation: a robot each, the factor on the model's covariance of its poses.
    """

    landmarks: Float[np.ndarray, "n n"]
    poses: tuple[Float[np.ndarray, "_ 3 3"], ...]
    calibration: tuple[Float[np.ndarray, "5"], ...]
    inflation: tuple[float, ...]


def team_covariance(
    team: TeamProblem,
    solution: Solution,
    before: Float[np.ndarray, "n n"],
    pattern: Pattern | None = None,
) -> TeamCovariance:
    """The covariances at `solution`, told in the frame that the landmarks as a body are.

    The map's origin is one robot's first pose, whose own errors would stand in every covariance; so all of them are
    taken off the motions of the landmarks as a whole (Baarda's S-transformation). Information is that of the costs'
    curvature. Landmarks and calibration are sandwiches. Where there are fewer than `cfg.groups` groups for each of
    these variables, a sandwich would be too sure of itself: what they have from sightings and steps is then the model's
    covariance times one number, by how much all groups together scatter more than the model says. For the share of
    errors that residuals lack the rest speaks, or the model where it says more; and `cfg.few_raised` is added, since
    few groups do not tell a covariance well. A pose has too few groups of its own for either: it has the model's
    covariance, times that number or how much more its robot's sightings (where it made none, those of it) within a few
    seconds pull together than if they were independent, whichever is larger. In a team with a laser both numbers are 1
    and the information is the solver's: noise is wide there for the same reasons.

    before: (2n, 2n), the landmarks' covariance when the smoothing began, which says how well the size of a map is known
    that nothing but ranges tells; pattern: of the problem, where it is known already. Raises SingularError where the
    problem leaves something free.
    """
    groups = Groups.of(team, CLUSTER)
    known = _Known.of(team, solution, groups, pattern)
    hubs = np.arange(team.landmark_start, len(solution.x))
    m = 2 * len(team.landmarks)
    few = known.groups < SMOOTHING_GROUPS * np.count_nonzero(solution.free >= team.landmark_start)
    influence, model = known.influence(hubs, 1.0 if few else MOST_CORRECTED), known.model()
    by = 1.0
    if not team.has_laser:
        white, directions = known.whitened(model)
        by = scatter(influence[:, :m] @ white, known.groups)
        if few:
            taken = taken_out(team, solution.x, groups, known.information, known.free, directions)
            by = (1.0 + FEW_RAISED) * (by + taken * max(1.0, by / (1.0 - taken)))
    factors = [max(by, _correlation(team, k, solution.x, SMOOTHING_MEMORY)) for k in range(len(team.parts))]
    if few:
        priors = influence[known.groups :].T @ influence[known.groups :]
        S = symmetrise(by * (model - priors) + priors)
    else:
        S = symmetrise(influence.T @ influence)
    poses = [f * P + FLOOR for f, P in zip(factors, known.pose_blocks(), strict=True)]
    deviations = np.sqrt(np.maximum(np.diag(S)[m:], 0.0)).reshape(-1, len(PARAMETERS))
    landmarks = S[:m, :m] + POSITION_FLOOR**2 * np.eye(m)
    if team.size_is_held:
        landmarks, poses = _with_size(team, solution.x, before, landmarks, poses)
    return TeamCovariance(landmarks, tuple(poses), tuple(deviations), tuple(factors))


def covariance_of_shape(
    team: TeamProblem, solution: Solution
) -> tuple[Float[np.ndarray, "m m"], list[Float[np.ndarray, "_ 3 3"]]]:
    """The covariances of landmarks, jointly, and of poses, a robot each, where factors err as they say.

    Told in the frame that the landmarks as a body are, as those of `team_covariance`, whatever ties that to a world.
    """
    if solution.information is None:
        raise SingularError("the team's problem is singular: something in it is not observed")
    known = _Known.told(team, solution, solution.information, sp.csr_matrix((0, len(solution.free))), 0)
    m = 2 * len(team.landmarks)
    return known.model()[:m, :m] + POSITION_FLOOR**2 * np.eye(m), [P + FLOOR for P in known.pose_blocks()]


def covariance_of_body(
    team: TeamProblem, solution: Solution, names: Collection[str], at: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "3 3"]:
    """Of where landmarks `names`, two or more, lie in the world as one body: of its point `at` and its turn."""
    columns = team.landmark_columns.reshape(-1, 2)[[name in names for name in team.landmarks]].ravel()
    taken = np.linalg.pinv(_motions(team, solution.x)[columns])
    J = np.array([[1.0, 0.0, -at[1]], [0.0, 1.0, at[0]], [0.0, 0.0, 1.0]])
    return symmetrise(J @ taken @ solution.covariance(columns) @ taken.T @ J.T)


def _with_size(
    team: TeamProblem,
    x: Float[np.ndarray, " n"],
    before: Float[np.ndarray, "m m"],
    landmarks: Float[np.ndarray, "m m"],
    poses: Sequence[Float[np.ndarray, "_ 3 3"]],
) -> tuple[Float[np.ndarray, "m m"], list[Float[np.ndarray, "_ 3 3"]]]:
    """The covariances with what nobody knows of the map's size: as much as `before`, that of the filters, had."""
    points = x[team.landmark_columns].reshape(-1, 2)
    centre = points.mean(axis=0)
    away = (points - centre).ravel()
    variance = float(away @ before @ away) / float(away @ away) ** 2
    out = []
    for part, P in zip(team.parts, poses, strict=True):
        from_centre = x[part.start : part.start + 3 * len(part.instants.t)].reshape(-1, 3)[:, :2] - centre
        more = np.zeros_like(P)
        more[:, :2, :2] = variance * from_centre[:, :, None] * from_centre[:, None, :]
        out.append(P + more)
    return landmarks + variance * np.outer(away, away), out


@dataclass(frozen=True, slots=True)
class _Known:
    """The information at a solution, the scores of each group of factors, and the frame they are told in.

    position: (n,) of every entry of x among the free ones, -1 where it is held; scores: (groups, free), the last
    `priors` of them those of priors; motions: (n, 3), how x changes when the whole is shifted and turned; taken: (3,
    hubs), how much of each motion a change of landmarks and calibration is.
    """

    team: TeamProblem
    information: Information
    position: Int[np.ndarray, " n"]
    free: Int[np.ndarray, " f"]
    scores: sp.csr_matrix
    priors: int
    motions: Float[np.ndarray, "n 3"]
    taken: Float[np.ndarray, "3 h"]

    @classmethod
    def of(cls, team: TeamProblem, solution: Solution, groups: Groups, pattern: Pattern | None = None) -> "_Known":
        if solution.information is None:
            raise SingularError("the team's problem is singular: something in it is not observed")
        information = solution.information if team.has_laser else curved(team, solution.x, pattern or team.pattern)
        known, own = _priors(team, solution.x), scores(team, solution.x, groups)
        pulls = sp.csr_matrix(sp.vstack([own[np.diff(own.indptr) > 0], known]))[:, solution.free]
        return cls.told(team, solution, information, pulls, known.shape[0])

    @classmethod
    def told(
        cls, team: TeamProblem, solution: Solution, information: Information, pulls: sp.csr_matrix, priors: int
    ) -> "_Known":
        """In the frame that the landmarks as a body are; pulls: the scores, the last `priors` of them of priors."""
        n = len(solution.x)
        position = np.full(n, -1)
        position[solution.free] = np.arange(len(solution.free))
        motions = _motions(team, solution.x)
        taken = np.zeros((3, n - team.landmark_start))
        if len(team.landmarks) > 1:
            taken[:, : 2 * len(team.landmarks)] = np.linalg.pinv(motions[team.landmark_columns])
        return cls(team, information, position, solution.free, pulls, priors, motions, taken)

    @property
    def groups(self) -> int:
        return int(self.scores.shape[0]) - self.priors

    def whitened(self, model: Float[np.ndarray, "h h"]) -> tuple[Float[np.ndarray, "m q"], Float[np.ndarray, "n q"]]:
        """What the map's shape is measured by in standard deviations of `model`: of landmarks, and of x, frame free."""
        at = self.team.landmark_columns
        value, vector = np.linalg.eigh(model[: len(at), : len(at)])
        shape = value > UNTOLD * np.max(value, initial=0.0)
        white = vector[:, shape] / np.sqrt(value[shape])
        of_x = np.zeros((len(self.position), white.shape[1]))
        of_x[at] = white
        of_x[self.team.landmark_start :] -= self.taken.T @ (self.motions[at].T @ white)
        return white, of_x

    def model(self) -> Float[np.ndarray, "h h"]:
        """The model's covariance of landmarks and calibration, their motions as a whole taken off."""
        free = np.flatnonzero(self.free >= self.team.landmark_start)
        P = np.zeros((self.taken.shape[1], self.taken.shape[1]))
        at = self.free[free] - self.team.landmark_start
        P[np.ix_(at, at)] = self.information.covariance(free)
        A = np.eye(len(P)) - self.motions[self.team.landmark_start :] @ self.taken
        return symmetrise(A @ P @ A.T)

    def influence(self, index: Int[np.ndarray, " k"], most: float) -> Float[np.ndarray, "groups k"]:
        """How far the errors of each group and of each prior move the entries `index` of x.

        most: the largest factor for what landmarks and calibration themselves took out of the residuals.

        The rows' outer products add up to a covariance.
        """
        hubs = np.arange(self.team.landmark_start, len(self.position))
        of_hubs = self._influence(hubs)
        own = of_hubs if np.array_equal(index, hubs) else self._influence(index)
        out = own - (of_hubs @ self.taken.T) @ self.motions[index].T
        groups = float(len(out) - self.priors)
        shared = float(np.count_nonzero(self.free >= self.team.landmark_start))
        if groups:
            out[: len(out) - self.priors] *= np.sqrt(groups / max(groups - shared, groups / most))
        return np.asarray(out)

    def _influence(self, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "groups k"]:
        at = self.position[index]
        free = np.flatnonzero(at >= 0)
        out = np.zeros((self.scores.shape[0], len(index)))
        for a in range(0, len(free), CHUNK):
            part = free[a : a + CHUNK]
            out[:, part] = self.scores @ self.information.columns(at[part])
        return out

    def pose_blocks(self) -> list[Float[np.ndarray, "k 3 3"]]:
        """The model's covariance of every pose, a robot each.

        A motion of the landmarks and calibrations (the hubs h) as a whole is taken off each: with `U = P_:h T^T`, T
        what that motion is of h, and M how it moves the pose, `P_pp - M U_p^T - U_p M^T + M (T U_h) M^T`.
        """
        hub = np.flatnonzero(self.free >= self.team.landmark_start)
        taken = self.taken[:, self.free[hub] - self.team.landmark_start]
        right = np.zeros((len(self.free), 3))
        right[hub] = taken.T
        U = self.information.solve(right)
        ends = np.cumsum([len(part.instants.t) for part in self.team.parts])
        at = self.position[: 3 * ends[-1]].reshape(-1, 3)
        poses = np.flatnonzero((at >= 0).all(axis=1))
        blocks = np.zeros((len(at), 3, 3))
        blocks[poses] = self.information.blocks(at[poses])
        M = self.motions[: 3 * len(at)].reshape(-1, 3, 3)
        across = np.zeros_like(blocks)
        across[poses] = M[poses] @ U[at[poses]].transpose(0, 2, 1)
        blocks += M @ symmetrise(taken @ U[hub]) @ M.transpose(0, 2, 1) - across - across.transpose(0, 2, 1)
        return np.split(blocks, ends[:-1])


def _motions(team: TeamProblem, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """How x changes when the whole map is shifted along x, along y, and turned."""
    out = np.zeros((len(x), 3))
    poses, points = np.arange(0, team.landmark_start, 3), team.landmark_columns[::2]
    for at in (poses, points):
        out[at, 0] = out[at + 1, 1] = 1.0
        out[at, 2], out[at + 1, 2] = -x[at + 1], x[at]
    out[poses + 2, 2] = 1.0
    return out


def _priors(team: TeamProblem, x: Float[np.ndarray, " n"]) -> sp.csr_matrix:
    """What one standard deviation of error of each prior and of each trajectory from scans would pull, (priors, n)."""
    rows = [sp.csr_matrix((0, len(x)))]
    for term, origin in zip(team.factors, team.origins, strict=True):
        if origin is None:
            pull = _pulls(term, x)
            row = np.repeat(np.arange(len(pull)), pull.shape[1])
            columns = np.repeat(term.columns, term.rows, axis=0).ravel()
            rows.append(sp.csr_matrix((pull.ravel(), (row, columns)), shape=(len(pull), len(x))))
    return sp.csr_matrix(sp.vstack(rows))


def _pulls(term: Factor, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "p d"]:
    """Rows whose outer products add up to the term's information."""
    if term.columns.shape[1] == 1:
        information = term.normal(x)[0] + TINY * np.eye(term.columns.shape[1])
        return np.asarray(np.linalg.cholesky(information)[:, :, 0], dtype=np.float64)
    J, W = term.jacobian(x), term.sqrt_info
    if W is not None:
        J = W[..., None] * J if W.ndim == 2 else W @ J
    return np.asarray((np.sqrt(term.weights(x))[:, None, None] * J).reshape(-1, J.shape[2]))


def _correlation(team: TeamProblem, robot: int, x: Float[np.ndarray, " n"], length: float) -> float:
    """How much more a robot's sightings of one landmark within `length` [s] pull together than if independent; >= 1.

    Of a robot that saw no landmark, the others' sightings of it. In a team with a laser 1: scans give the trajectories,
    and the noise of sightings is so wide there because their errors last, which would count twice.
    """
    if team.has_laser:
        return 1.0
    part = team.parts[robot]
    pairs = [(t, o) for t, o in zip(team.factors, team.origins, strict=True) if o is not None]
    terms = [(t, o, np.arange(len(o.t))) for t, o in pairs if o.robot == robot and t.name == "landmark"]
    alike = not terms  # they all see this one robot
    if alike:
        last = part.start + 3 * len(part.instants.t)
        of_it = [(t.columns[:, 3] >= part.start) & (t.columns[:, 3] < last) for t, _ in pairs]
        terms = [
            (t, o, np.flatnonzero(mine))
            for (t, o), mine in zip(pairs, of_it, strict=True)
            if o.robot != robot and t.name == "robot" and mine.any()
        ]
    together = alone = 0.0
    for term, origin, rows in terms:
        g = term.normal(x)[1][rows, 3:5]
        what = np.zeros(len(g), int) if alike else term.columns[rows, 3]
        group = np.unique(np.stack([origin.t[rows] // length, what], axis=-1), axis=0, return_inverse=True)[1].ravel()
        together += sum(float(np.square(np.bincount(group, weights=g[:, k])).sum()) for k in (0, 1))
        alone += float(np.square(g).sum())
    return max(1.0, together / alone) if alone > 0 else 1.0
