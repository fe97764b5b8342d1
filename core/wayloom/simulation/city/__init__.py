"""The static city: street graph, terrain, blocks, buildings, furniture, true outlines."""
