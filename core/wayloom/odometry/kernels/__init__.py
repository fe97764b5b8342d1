"""Compiled kernels of the odometry: arrays in, arrays out. They import numpy, numba and each other only and never raise.

Strict IEEE arithmetic everywhere (no fastmath): the same input gives the same bits, and a NaN stays a NaN that can be found.
"""
