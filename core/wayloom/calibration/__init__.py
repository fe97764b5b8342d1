"""Calibration of a stereo rig: its relative lens by bundle adjustment over several of its drives. docs/calibration.md."""
