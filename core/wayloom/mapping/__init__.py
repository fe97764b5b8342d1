"""Pose graphs: the only import of gtsam."""
