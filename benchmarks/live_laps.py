"""What a map process keeps of one laser robot that drives the same round again and again, lap by lap.

    python benchmarks/live_laps.py [--laps 5]

The robot's messages are worked in, woven and drawn without a network. Printed are, after each lap, the memory of the
process, the keyframes in the graph, what their returns take, and, of the C library's heap, what is free between them.
"""

import argparse
import ctypes
import gc
import tempfile
from pathlib import Path

from live import memory, one_round, prepared, renamed
from mapweave.core.workers import keep_one_blas_thread
from mapweave.live.laser_team import LiveLaserTeam, nobody
from mapweave.live.store import Store
from mapweave.mapping.config import LaserConfig

AT_ONCE = 20  # messages between two maps
SOLVED = 3  # maps between two solutions


class Heap(ctypes.Structure):
    """What mallinfo2 tells, in ten numbers; free0: bytes that are free."""

    _fields_ = tuple(
        (f"{name}{k}", ctypes.c_size_t) for name, k in [*(("before", k) for k in range(8)), ("free", 0), ("top", 0)]
    )


def holes() -> float:
    """[MB] free in the heap of the thread that asks."""
    library = ctypes.CDLL("libc.so.6")
    library.mallinfo2.restype = Heap
    return library.mallinfo2().free0 / 1e6


def returns(team: LiveLaserTeam) -> float:
    """[MB] of all keyframes."""
    nodes = team.robots["r1"].session.keyframes.nodes
    return sum(b.s.nbytes + b.normal.nbytes + b.support.nbytes for b in (node.beams for node in nodes)) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--laps", type=int, default=5)
    given = parser.parse_args()
    keep_one_blas_thread()
    stamps = one_round(1)[0].odometry.t
    lasts = float(stamps[-1] - stamps[0]) + 0.2
    told = [one.message for one in prepared("laser", 1, lasts * given.laps, 1.0) if one.topic == "log"]
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder, "s"), "a map") as store:
        store.put([("r1", message.seq, renamed(message, "r1", 1)) for message in told])
        total = len(told)
        del told
        one_round.cache_clear()
        team = LiveLaserTeam(store, LaserConfig(method="graph", threads=1), nobody)
        done = maps = 0
        print("| lap | memory | keyframes | their returns | holes in the heap |\n|---|---|---|---|---|")
        for lap in range(1, given.laps + 1):
            while done < total * lap // given.laps:
                done = min(done + AT_ONCE, total * lap // given.laps)
                while team.follow({"r1": done}):
                    pass
                weaving = team.weaving() if maps % SOLVED == 0 else None
                if weaving is not None:
                    team.take(weaving.run())
                team.draw({"r1": done})
                maps += 1
            gc.collect()
            size = team.robots["r1"].size
            kept = f"{memory('VmRSS') / 1024:.0f} MB | {size} | {returns(team):.1f} MB | {holes():.1f} MB"
            print(f"| {lap} | {kept} |", flush=True)
    print(f"\n{lasts:.0f} s a lap")


if __name__ == "__main__":
    main()
