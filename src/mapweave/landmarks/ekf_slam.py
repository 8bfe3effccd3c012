"""EKF-SLAM of one robot with known landmark identities: pose, landmarks and its sensors' biases in one state.

The frame is `local_K`, the robot's first pose, with zero covariance. `init` and `step` run under `core.run.run`: a log
comes as one packet, a live robot as many, and both give the same numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.records import Event, LandmarkPacket, Odometry, Sightings, Track, frozen
from ..kernels.landmarks import ekf
from ..kernels.landmarks.ekf import (
    CANDIDATES,
    HEAD,
    POSE,
    RANGE_SCALE,
    Belief,
    Commands,
    LandmarkTable,
    PoseRows,
    SightingRows,
    UpdateOutcomes,
    apply_drive,
    clear,
)
from .config import EkfSlamConfig, calibration_prior, noise
from .landmark_map import Submap


class UpdateStatus(Enum):
    """What became of an event."""

    USED = "used"
    LATE = "late"  # stamped before what was already worked in: left out
    IGNORED = "ignored"  # a record this estimator has no use for


@dataclass(frozen=True, slots=True)
class EkfSlamState:
    """The estimate and what the next event needs. Layout of `x` and `P`: see `kernels.landmarks.ekf`.

    ids: landmark of each slot, `started` or still waiting; t: None before the first event; commands: those not yet
    worked off, the one in force first when `at` is 0.
    """

    robot: str
    t: float | None
    x: Float[np.ndarray, " m"]
    P: Float[np.ndarray, "m m"]
    Phi: Float[np.ndarray, "3 8"]
    Q: Float[np.ndarray, "3 3"]
    commands: Float[np.ndarray, "3 n"]
    at: int
    ids: tuple[str, ...]
    slot: Mapping[str, int]
    started: Bool[np.ndarray, " k"]
    waiting: Float[np.ndarray, "k 8 2"]
    n_waiting: Int[np.ndarray, " k"]
    astray: Int[np.ndarray, "1"]  # far sightings in a row

    @property
    def frame(self) -> str:
        return f"local_{self.robot.removeprefix('robot')}"

    @property
    def submap(self) -> Submap:
        """Pose and started landmarks in `frame`, the calibration marginalised away, distances in the range sensor's."""
        return submap(self.robot, self.frame, self.x, self.covariance(), self.ids, self.started)

    def covariance(self) -> Float[np.ndarray, "m m"]:
        """The covariance of `x` now, what was driven since the last sighting included."""
        P = self.P.copy()
        apply_drive(P, len(self.x), self.Phi.copy(), self.Q.copy())
        return P


NOWHERE = Track(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
NONE = frozen(np.zeros(0))


@dataclass(frozen=True, slots=True)
class EkfSlamInfo:
    """What an event did. track: poses at its stamps; nis, weight: of each sighting, NaN where it was no update."""

    status: UpdateStatus
    track: Track = NOWHERE
    nis: Float[np.ndarray, " n"] = field(default_factory=lambda: NONE)
    weight: Float[np.ndarray, " n"] = field(default_factory=lambda: NONE)


def init(robot: str, cfg: EkfSlamConfig, rng: np.random.Generator) -> EkfSlamState:  # noqa: ARG001
    """`initial`, as `run` calls it."""
    return initial(robot, cfg)


def initial(robot: str, cfg: EkfSlamConfig) -> EkfSlamState:
    """Nothing seen, at the origin of `local_K`, sensors as the configuration expects them."""
    x, P = np.zeros(HEAD), np.zeros((HEAD, HEAD))
    x[POSE:], sd = calibration_prior(cfg)
    P[range(POSE, HEAD), range(POSE, HEAD)] = sd**2
    Phi, Q = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    clear(Phi, Q)
    nothing = (np.zeros(0, bool), np.zeros((0, CANDIDATES, 2)), np.zeros(0, np.int64), np.zeros(1, np.int64))
    return EkfSlamState(robot, None, x, P, Phi, Q, np.zeros((3, 0)), -1, (), {}, *nothing)


def step(
    state: EkfSlamState,
    event: Event,
    cfg: EkfSlamConfig,
    rng: np.random.Generator,  # noqa: ARG001
) -> tuple[EkfSlamState, EkfSlamInfo]:
    """`state` with `event` worked in: driven to every row and updated with every sighting, however rows are packed."""
    record = event.record
    if isinstance(record, Sightings):
        n = len(record.ids)
        record = LandmarkPacket(None, np.full(n, event.t), np.arange(n), record.range, record.bearing, record.ids)
    if not isinstance(record, Odometry | LandmarkPacket):
        return state, EkfSlamInfo(UpdateStatus.IGNORED)
    if state.t is not None and (record.t[0] if isinstance(record, Odometry) else first_stamp(record)) < state.t:
        return state, EkfSlamInfo(UpdateStatus.LATE)
    return _drive(state, record, cfg) if isinstance(record, Odometry) else _work_in(state, record, cfg)


def _drive(state: EkfSlamState, record: Odometry, cfg: EkfSlamConfig) -> tuple[EkfSlamState, EkfSlamInfo]:
    x, Phi, Q = state.x.copy(), state.Phi.copy(), state.Q.copy()
    commands = np.concatenate([state.commands, np.stack([record.t, record.v, record.w])], axis=1)
    n, t = len(record.t), float(record.t[0]) if state.t is None else state.t
    pose, cov = np.empty((n, POSE)), np.empty((n, 6))
    belief = Belief(x, state.P, Phi, Q)
    t, at = ekf.drive_rows(belief, t, Commands(*commands), commands.shape[1], state.at, n, noise(cfg), pose, cov)
    gone = max(at, 0)
    new = replace(state, t=t, x=x, Phi=Phi, Q=Q, commands=commands[:, gone:].copy(), at=at - gone)
    return new, EkfSlamInfo(UpdateStatus.USED, Track(record.t, pose, square(cov), state.frame))


def _work_in(state: EkfSlamState, record: LandmarkPacket, cfg: EkfSlamConfig) -> tuple[EkfSlamState, EkfSlamInfo]:
    used, first = np.unique(record.what, return_index=True)
    fresh = [record.ids[k] for k in used[np.argsort(first)]]  # slots in the order of first sighting
    new = with_slots(state, tuple(name for name in fresh if is_landmark(name)))
    slots = np.array([new.slot.get(name, -1) for name in record.ids], dtype=np.int64)[record.what]
    o = record.odometry
    rows = np.zeros((3, 0)) if o is None else np.stack([o.t, o.v, o.w])
    commands = np.concatenate([new.commands, rows], axis=1)
    n, most = len(record.t), rows.shape[1] + len(record.t)
    fit = np.empty((2, n))
    t, pose, cov = np.empty(most), np.empty((most, POSE)), np.empty((most, 6))
    places = LandmarkTable(new.started.copy(), new.waiting.copy(), new.n_waiting.copy(), new.astray.copy())
    belief = Belief(new.x.copy(), new.P.copy(), new.Phi.copy(), new.Q.copy())
    sightings = SightingRows(*(np.array(c) for c in (record.t, slots, record.range, record.bearing)))
    start = first_stamp(record) if state.t is None else state.t
    tracked, at = ekf.replay(
        belief, start, Commands(*commands), new.at, new.commands.shape[1], sightings, noise(cfg), places,
        UpdateOutcomes(*fit), PoseRows(t, pose, cov),
    )  # fmt: skip
    gone = max(at, 0)
    track = Track(t[:tracked], pose[:tracked], square(cov[:tracked]), new.frame)
    new = replace(
        new, t=float(t[tracked - 1]), commands=commands[:, gone:].copy(), at=at - gone,
        started=places.started, waiting=places.waiting, n_waiting=places.filled, astray=places.astray,
        **belief._asdict(),
    )  # fmt: skip
    return new, EkfSlamInfo(UpdateStatus.USED, track, *fit)


def first_stamp(record: LandmarkPacket) -> float:
    """The stamp [s] of the first row of a stretch that has one."""
    stamps = [record.t[:1]] if record.odometry is None else [record.t[:1], record.odometry.t[:1]]
    return float(np.concatenate(stamps).min())


def with_slots(state: EkfSlamState, names: tuple[str, ...]) -> EkfSlamState:
    """`state` with a slot, not started, for each name it has none for."""
    fresh = tuple(dict.fromkeys(name for name in names if name not in state.slot))
    if not fresh:
        return state
    old, k = len(state.x), len(fresh)
    size = old + 2 * k
    P = np.zeros((size, size))
    P[:old, :old] = state.P
    return replace(
        state,
        x=np.concatenate([state.x, np.zeros(2 * k)]),
        P=P,
        ids=state.ids + fresh,
        slot={**state.slot, **{name: len(state.ids) + k for k, name in enumerate(fresh)}},
        started=np.concatenate([state.started, np.zeros(k, bool)]),
        waiting=np.concatenate([state.waiting, np.zeros((k, CANDIDATES, 2))]),
        n_waiting=np.concatenate([state.n_waiting, np.zeros(k, np.int64)]),
    )


def is_landmark(name: str) -> bool:
    """Sightings of robots are kept for fusion, not used here; nor are those of what has no name."""
    return bool(name) and not name.startswith("robot")


def submap(robot: str, frame: str, x: np.ndarray, P: np.ndarray, ids: tuple[str, ...], started: np.ndarray) -> Submap:
    """The map in `x`, `P` (drive applied), its distances those of the range sensor: multiplied by the range scale."""
    slots = np.flatnonzero(started)
    kept = np.concatenate([np.arange(HEAD), (HEAD + 2 * slots[:, None] + np.arange(2)).ravel()])
    x, P = x[kept], P[np.ix_(kept, kept)]  # to the bit the same, whatever waits beside
    rows = np.concatenate([np.arange(POSE), np.arange(HEAD, len(x))])
    s = float(x[RANGE_SCALE])
    by = np.ones(len(rows))
    by[rows != 2] = s
    J = np.zeros((len(rows), len(x)))
    J[np.arange(len(rows)), rows] = by
    J[rows != 2, RANGE_SCALE] = x[rows[rows != 2]]
    cov = J @ P @ J.T
    value = x[rows] * by
    pose = value[:POSE].copy()
    return Submap(robot, pose, tuple(ids[k] for k in slots), value[POSE:].reshape(-1, 2), 0.5 * (cov + cov.T), frame)


def square(packed: np.ndarray) -> Float[np.ndarray, "n 3 3"]:
    """(n, 3, 3) covariances from rows xx, xy, xt, yy, yt, tt."""
    return frozen(packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
