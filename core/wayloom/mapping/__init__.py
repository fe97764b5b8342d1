"""Pose graph optimisation of drives; the only import of gtsam."""
