"""Splatting kernels: arrays in, arrays out."""
