"""Rendering: rasteriser, light, rain, outlines of instances."""
