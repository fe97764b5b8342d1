"""Procedural materials: noise, painters, the texture stack."""
