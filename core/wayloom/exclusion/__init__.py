"""Exclusion of areas: what a drive saw inside of them is dropped from all that is kept of it."""
