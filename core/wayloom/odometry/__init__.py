"""Stereo direct sparse odometry. Start at `wayloom.odometry.odometry`; its result is in `wayloom.odometry.types`."""
