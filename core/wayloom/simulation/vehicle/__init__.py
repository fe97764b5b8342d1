"""The recording vehicle: settings, stereo rigs and their faults, motion."""
