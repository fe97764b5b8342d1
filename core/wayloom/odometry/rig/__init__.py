"""The stereo rig as it is: row alignment, the right lens undone, observations for calibration."""
