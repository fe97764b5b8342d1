"""Remaining time of drives: the estimate, the intervals that were told, and how often the truth lay within."""
