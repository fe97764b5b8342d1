"""Debug records of the odometry: per-frame tables and pictures."""
