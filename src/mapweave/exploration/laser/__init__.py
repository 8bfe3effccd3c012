"""Teams that explore a building with lasers: what they know, how they plan and drive, one mission, its scores."""
