"""Temporally consistent labelling (TCL) of the odometry's points."""
