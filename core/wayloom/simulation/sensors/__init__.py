"""Sensor models: camera, exposure, optics, GNSS, IMU, LiDAR, clock."""
