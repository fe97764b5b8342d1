"""Voxel accumulation kernels: arrays in, arrays out."""
