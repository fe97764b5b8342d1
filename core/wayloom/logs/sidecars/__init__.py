"""Sensor records kept beside the images: GNSS, IMU and exposure as CSV, OXTS packets."""
