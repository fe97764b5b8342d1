"""EuRoC/ASL folders: `mav0` with cam0, cam1, imu0 and ground truth."""
