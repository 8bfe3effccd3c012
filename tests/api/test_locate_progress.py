"""Long work of `locate` is told while it runs."""

import mapweave
from mapweave.sim.swarm import SwarmScene


def test_growing_and_smoothing_are_told_from_begin_to_end(tmp_path):
    made = tmp_path / "s.csv"
    scene = SwarmScene(robots=9, steps=60, drive=True, axis=False)
    mapweave.simulate_swarm(made, scene=scene, seed=1)
    heard = []
    mapweave.locate(
        made,
        tmp_path / "out",
        odometry=tmp_path / "s.odometry.csv",
        axis=False,
        on_progress=lambda stage, done, total=None: heard.append((stage, done, total)),
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in heard))
    assert stages == ["reading", "locating", "growing tracks", "smoothing", "writing"]
    for stage in stages:
        told = [(done, total) for name, done, total in heard if name == stage]
        assert [done for done, _ in told] == sorted(done for done, _ in told)
        assert told[0][0] == 0
        assert told[-1][0] == told[-1][1]
    assert sum(stage == "growing tracks" for stage, _, _ in heard) > 3
