"""One map from many local maps, and why each was or was not merged."""
