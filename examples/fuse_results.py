"""Two recordings of one place become one map; and a recording of another place is refused."""

from pathlib import Path
from tempfile import TemporaryDirectory

import mapweave

with TemporaryDirectory() as folder:
    home = Path(folder)
    # Robots 1 and 2 are mapped in two runs, as if their logs came on two days.
    team = mapweave.simulate_landmarks(home / "team", robots=2, landmarks=12, minutes=1.5, seed=8)
    day1, day2 = (mapweave.map(home / "team", home / f"day{robot}", robots=[robot]) for robot in ("1", "2"))

    # A second place has landmarks of the same names at other places.
    mapweave.simulate_landmarks(home / "other", robots=2, landmarks=12, minutes=1.5, seed=9)
    mapweave.map(home / "other", home / "elsewhere", robots=["1"])

    # Results are fused as they are in memory, or from their folders.
    together = mapweave.fuse([day1, day2])
    print(together.summary())

    # What is true may be a table too: here the surveyed landmarks.
    x, y = zip(*team.landmarks.values(), strict=True)
    score = mapweave.evaluate(together, {"id": list(team.landmarks), "x": x, "y": y}).metrics
    print(f"landmark RMSE {score['landmark_rmse']:.3f} m")

    # Names alone are no proof: each decision tells its reason.
    for robot in mapweave.fuse([home / "day1", home / "elsewhere"]).metrics["fusion"]:
        print(f"{robot['robot']}: {robot['decision']}, {robot['reason']}")
