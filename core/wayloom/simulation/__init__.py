"""The synthetic city and its fleet, with exact truth."""
