"""KITTI's three layouts (odometry, raw, KITTI-360): readers, writers, calibration files, accumulated clouds."""
