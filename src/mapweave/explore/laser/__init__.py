"""Teams with laser scanners: what they know, how they plan and drive, one mission, its scores."""
