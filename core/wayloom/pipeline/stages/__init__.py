"""Rooms of the drive's stages, one module a stage; `wayloom.config.stages` lists them."""
