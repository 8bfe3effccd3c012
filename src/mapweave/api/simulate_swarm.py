"""Simulated sightings of a swarm that sees itself, with their truth, as files that `locate` reads."""

from pathlib import Path

import numpy as np

from ..core.errors import UsageError
from ..core.threads import one_blas_thread
from ..io.swarm import write_sightings
from ..io.table import write_table
from ..sim.swarm import Swarm, SwarmScene
from ..sim.swarm import simulate_swarm as simulate


@one_blas_thread()
def simulate_swarm(out: Path | str | None = None, scene: SwarmScene | None = None, *, seed: int = 0) -> Swarm:
    """The swarm (the same for the same seed), written to `out` and beside it when a file is given.

    Beside FILE.csv stand FILE.truth.csv (`id,x,y[,z]`, and `t`, `heading` where they mean something) and, when the
    robots drive, FILE.odometry.csv (`t,robot,v,w`). Raises UsageError for a scene that cannot be.
    """
    made = simulate(scene or SwarmScene(), np.random.default_rng(seed))
    if out is not None:
        path = Path(out)
        if path.is_dir() or not path.suffix:
            raise UsageError(f"--out {path}: expected a file name such as swarm.csv or swarm.parquet")
        write_sightings(path, made.table)
        _write_truth(path.with_suffix(".truth.csv"), made)
        if made.odometry is not None:
            _write_odometry(path.with_suffix(".odometry.csv"), made)
    return made


def _write_truth(path: Path, made: Swarm) -> None:
    moving = made.table.t is not None
    turned = not made.table.axis or made.odometry is not None
    head = ["id", "x", "y", "z"][: 1 + made.table.dim] + ["t"] * moving + ["heading"] * turned
    rows = []
    for k, t in enumerate(made.t.tolist()):
        places, headings = made.position[k].tolist(), made.heading[k].tolist()
        rows += [
            (name, *place, *([t] if moving else []), *([heading] if turned else []))
            for name, place, heading in zip(made.table.ids, places, headings, strict=True)
        ]
    write_table(path, head, rows)


def _write_odometry(path: Path, made: Swarm) -> None:
    assert made.odometry is not None  # noqa: S101
    still = set(made.corners)
    rows = [
        (t, name, *made.odometry[k, i].tolist())
        for k, t in enumerate(made.t.tolist())
        for i, name in enumerate(made.table.ids)
        if i not in still
    ]
    write_table(path, ["t", "robot", "v", "w"], rows)
