"""Compiled kernels of the segmentation: arrays in, arrays out."""
