"""The synthetic city and its fleet, with exact truth for everything that a drive records."""
