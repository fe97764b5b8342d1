"""Compiled kernels of the odometry: arrays in, arrays out; NaN or a status array where the input is bad, never an exception."""
