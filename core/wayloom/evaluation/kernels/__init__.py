"""Kernels of the measurements: arrays in, arrays out."""
