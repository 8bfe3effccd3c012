"""What a map is: landmarks, submaps, grids."""
