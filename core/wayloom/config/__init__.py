"""What every room shares without knowing each other: the classes, the base of all settings, progress, where data lies."""
