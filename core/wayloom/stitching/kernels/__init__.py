"""Compiled kernels of the stitching: arrays in, arrays out."""
