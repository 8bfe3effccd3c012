"""One map from many landmark maps, and why each was or was not merged."""
