"""Teams that explore a field of landmarks: planners, one mission step by step, its scores."""
