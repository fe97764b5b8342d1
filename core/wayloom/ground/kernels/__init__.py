"""Compiled kernels of the ground sheets: arrays in, arrays out."""
