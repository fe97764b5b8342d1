"""Compiled kernels of the logs: arrays in, arrays out."""
