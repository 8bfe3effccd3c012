"""Hamatani, Nakamura, Naruse: five camera robots that locate themselves from bearings."""
