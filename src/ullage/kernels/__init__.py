"""Numba loops over plain arrays: arrays in, arrays out, none of our types, no checks."""
