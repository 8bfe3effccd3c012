"""Where every robot of a swarm is, from bearings alone. [Hamatani], and what goes beyond."""
