"""Rigid-body transforms, camera models and rectification: pure functions on arrays. Conventions: docs/conventions.md."""
