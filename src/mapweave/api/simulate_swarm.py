"""Simulated sightings of a swarm that sees itself, with their truth, as files that `locate` reads."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import UsageError
from ..core.paths import path_arguments, path_of
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.sightings import write_sightings
from ..io.table import write_table
from ..report.result import ResultBase
from ..sim.swarm import Swarm, SwarmScene
from ..sim.swarm import simulate_swarm as simulate

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class SimulatedSwarm(ResultBase, Swarm):
    """A simulated swarm that sees itself, its scene and seed. It is written to files, not to a folder."""

    scene: SwarmScene
    seed: int

    @property
    def metrics(self) -> dict[str, Any]:
        sightings = len(self.table.observer)
        return {"version": __version__, "seed": self.seed, "sightings": sightings, **asdict(self.scene)}

    def lines(self) -> list[str]:
        s = self.scene
        sigma = f"{np.degrees(s.sigma):.4g} deg"
        return [f"{s.robots} robots in {s.dim}D, {len(self.table.observer)} sightings, sigma {sigma}, seed {self.seed}"]

    def draw(self, target: "Target") -> None:
        """Where the robots are at first, and who sees whom."""
        from ..report.simulation import draw_world  # noqa: PLC0415  (figures cost half a second)

        pairs = zip(self.table.observer.tolist(), self.table.target.tolist(), strict=True)
        draw_world(target, "the simulated swarm", {}, self.position[0, :, :2], pairs=list(pairs))

    def write(self, folder: Path | str, *, force: bool = False) -> None:
        """The table `folder`, .csv or .parquet, and beside it the truth and the odometry; files there are replaced."""
        del force
        path = _table(folder)
        write_sightings(path, self.table)
        _write_truth(path.with_suffix(".truth.csv"), self)
        if self.odometry is not None:
            _write_odometry(path.with_suffix(".odometry.csv"), self)

    def write_into(self, folder: Path) -> None:
        self.write(folder / "swarm.csv")


@path_arguments
@one_blas_thread()
def simulate_swarm(out: Path | str | None = None, scene: SwarmScene | None = None, *, seed: int = 0) -> SimulatedSwarm:
    """Simulate a swarm of camera robots that measure bearings to each other.

    Written to `out` if given; the same seed gives the same swarm.

    Parameters
    ----------
    out
        The table to write, .csv or .parquet. Beside FILE.csv stand FILE.truth.csv (`id,x,y[,z]`, and `t`, `heading`
        where they mean something) and, when the robots drive, FILE.odometry.csv (`t,robot,v,w`).
    scene
        How many robots, how far they see, how they move, and the noise (`SwarmScene()`).
    seed
        Of everything drawn at random (0).

    Raises
    ------
    UsageError
        For a scene that cannot be, or an `out` that is no such file.
    """
    if out is not None:
        _table(out)
    scene = scene or SwarmScene()
    simulated = simulate(scene, np.random.default_rng(seed))
    result = SimulatedSwarm(**{f.name: getattr(simulated, f.name) for f in fields(simulated)}, scene=scene, seed=seed)
    if out is not None:
        result.write(out)
    return result


def _table(out: Path | str) -> Path:
    path = path_of(out, "out")
    if path.is_dir() or not path.suffix:
        raise UsageError(f"--out {path}: expected a file name such as swarm.csv or swarm.parquet")
    return path


def _write_truth(path: Path, swarm: Swarm) -> None:
    moving = swarm.table.t is not None
    turned = not swarm.table.axis or swarm.odometry is not None
    head = ["id", "x", "y", "z"][: 1 + swarm.table.dim] + ["t"] * moving + ["heading"] * turned
    rows = []
    for k, t in enumerate(swarm.t.tolist()):
        places, headings = swarm.position[k].tolist(), swarm.heading[k].tolist()
        rows += [
            (name, *place, *([t] if moving else []), *([heading] if turned else []))
            for name, place, heading in zip(swarm.table.ids, places, headings, strict=True)
        ]
    write_table(path, head, rows)


def _write_odometry(path: Path, swarm: Swarm) -> None:
    assert swarm.odometry is not None  # noqa: S101
    still = set(swarm.corners)
    rows = [
        (t, name, *swarm.odometry[k, i].tolist())
        for k, t in enumerate(swarm.t.tolist())
        for i, name in enumerate(swarm.table.ids)
        if i not in still
    ]
    write_table(path, ["t", "robot", "v", "w"], rows)
