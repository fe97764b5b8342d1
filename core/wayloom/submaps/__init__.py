"""Submaps: 50 to 100 m of one labelled drive, immutable and content-addressed."""
