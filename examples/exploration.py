"""Two robots decide where to drive until the field is known, and their map is scored."""

import mapweave

# A landmark field of 100 by 80 m, the paper's objective, two runs of at most 40 steps.
result = mapweave.explore("yuan", robots=2, runs=2, until=40, seed=1)
print(result.summary())

# Every run's score; means stand in the metrics as in metrics.json.
for run in result.runs:
    print(f"seed {run.seed}: {run.steps} steps, map error {run.map_error:.3f} m")
print(f"mean map error {result.metrics['summary']['map_error_m']:.3f} m")
