"""Kernels of the place index: hash tables of binary descriptors, and correlation of bird's-eye grids."""
