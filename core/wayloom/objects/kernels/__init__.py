"""Compiled kernels of the objects: arrays in, arrays out."""
