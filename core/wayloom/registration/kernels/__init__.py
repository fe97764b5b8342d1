"""Compiled kernels of the registration."""
