"""Self-calibration of the stereo rig: rectification of the right image, and observations for calibration."""
