"""Markings and kerbs on a raster of the ground."""
