"""wayloom weaves the drives of a vehicle fleet into one semantic 3D map of a city, from stereo cameras and GNSS alone."""

__version__ = "0.1.0"
