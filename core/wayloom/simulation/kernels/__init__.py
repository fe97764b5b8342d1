"""Rendering kernels: arrays in, arrays out. They import numpy, numba and each other only; callers check shapes."""
