"""Stereo direct sparse odometry. Start at `wayloom.odometry.odometry`; what it leaves is in `wayloom.odometry.types`."""
