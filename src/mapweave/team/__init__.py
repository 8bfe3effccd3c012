"""The whole team in one map: landmarks and the trajectories of the robots tied into it."""
