"""Compiled kernels of dense depth."""
