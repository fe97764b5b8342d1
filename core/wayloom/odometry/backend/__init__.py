"""Windowed optimisation: keyframe window, photometric bundle adjustment, marginalisation, inertial factors."""
