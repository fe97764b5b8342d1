"""Compiled kernels of the labelling: arrays in, arrays out."""
