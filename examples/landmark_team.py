"""A team drives among landmarks; each robot maps on its own, and one map is made of all of them."""

from pathlib import Path
from tempfile import TemporaryDirectory

import mapweave

# Three robots drive for a minute among twelve landmarks. Nobody knows where the others began.
with TemporaryDirectory() as folder:
    recording = Path(folder) / "team"
    mapweave.simulate_landmarks(recording, robots=3, landmarks=12, minutes=1.0, seed=5)

    # The truth in the recording is used for scoring alone.
    result = mapweave.map(recording, truth=recording)
    print(result.summary())

    # One map, with its covariance: landmarks by name, in the frame of robot 1's first pose.
    landmarks = result.maps[0].landmarks
    for name, place in zip(landmarks.ids, landmarks.mean, strict=True):
        print(f"landmark {name} at ({place[0]:.2f}, {place[1]:.2f}) m")

    # The folder that `mapweave map` writes, and the main picture as a Matplotlib figure.
    result.write(Path(folder) / "result")
    result.plot().savefig(Path(folder) / "map.png")
    print(f"landmark RMSE {result.metrics['evaluation']['landmark_rmse']:.3f} m")
