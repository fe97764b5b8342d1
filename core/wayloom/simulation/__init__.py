"""Synthetic city and vehicle fleet, with exact ground truth for everything that a drive records."""
