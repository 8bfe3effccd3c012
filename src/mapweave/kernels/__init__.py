"""The only home of Numba: arrays in, arrays out."""
