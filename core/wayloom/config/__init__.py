"""Settings, classes, progress and data locations that all rooms share."""
