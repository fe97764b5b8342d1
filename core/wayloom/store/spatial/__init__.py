"""Geometry in the database: tables of features that GIS programs read, box look-ups by a spatial index, and who may read."""
