"""Where every robot of a swarm is, from who sees whom in which direction."""

import numpy as np

import mapweave

# Forty-nine camera robots in the plane; each sees its eight nearest, one degree of noise.
swarm = mapweave.simulate_swarm(scene=mapweave.SwarmScene(robots=49), seed=3)
table = swarm.table

# Sightings as columns: ids of observer and target, bearing [rad] from the common x axis, counter-clockwise.
sightings = {
    "observer": [table.ids[k] for k in table.observer],
    "target": [table.ids[k] for k in table.target],
    "bearing": table.bearing(),
}

# Two robots' places fix scale, place and orientation; without them the shape alone is found.
anchors = {table.ids[k]: swarm.position[0, k] for k in swarm.corners[:2]}
result = mapweave.locate(sightings, anchors=anchors, sigma="1deg")
print(result.summary())

# Sightings without stamps are of robots that stand: the result holds one estimate of all.
assert isinstance(result, mapweave.Located)
assert result.estimate.cov is not None
error = np.linalg.norm(result.estimate.position - swarm.position[0], axis=1)
spread = np.sqrt(np.trace(result.estimate.cov, axis1=1, axis2=2))
print(f"RMSE {np.sqrt((error**2).mean()):.3f} m; promised {np.sqrt((spread**2).mean()):.3f} m")
